# SPDX-License-Identifier: Apache-2.0
"""The disc of table that a kept ground leaves with the object."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from robir.capture.camera import Camera
from robir.capture.images.opencv import cv2
from robir.capture.masks.sight import Array, Layer
from robir.capture.support import Plane, across

SPREAD = 1.5  # radius of the disc against the farthest part of the object
CORNERS = 180  # corners of the polygon drawn for the disc


def disc_about(volume: Array, plane: Plane) -> Array:
    """Rim of a disc on the plane that carries the object.

    Args:
        volume: (N, 3) points of the object, N >= 1.
        plane: What it stands on.

    Returns:
        (K, 3) points of the rim, in order.
    """
    axes = across(plane.normal)
    foot = volume @ axes.T
    middle = 0.5 * (foot.min(axis=0) + foot.max(axis=0))
    radius = SPREAD * float(np.linalg.norm(foot - middle, axis=1).max())
    turn = np.linspace(0, 2 * np.pi, CORNERS, endpoint=False)
    rim = middle + radius * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    return rim @ axes + plane.offset * plane.normal


def disc_picture(rim: Array, camera: Camera) -> Layer:
    """Share of each pixel that the disc covers, (H, W) float32; none where it is behind."""
    pixels, depth = camera.project(rim)
    cover = np.zeros((camera.height, camera.width), np.uint8)
    if (depth > 0).all():
        corners: NDArray[np.int32] = np.rint((pixels - 0.5) * 16).astype(np.int32)
        cv2.fillPoly(cover, [corners], 255, lineType=cv2.LINE_AA, shift=4)
    return cover.astype(np.float32) / np.float32(255)
