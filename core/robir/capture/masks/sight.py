# SPDX-License-Identifier: Apache-2.0
"""What cutting out asks of a photograph: pixels, small and in L*a*b*, and its camera."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from robir.capture.camera import Camera
from robir.capture.images.opencv import cv2

Array = NDArray[np.float64]
Layer = NDArray[np.float32]
Bytes = NDArray[np.uint8]


class Posed(Protocol):
    """A photograph with its camera."""

    @property
    def name(self) -> str:
        """Unique within the capture."""
        ...

    @property
    def image_display(self) -> Bytes:
        """(H, W, 3) uint8, display-referred."""
        ...

    @property
    def camera(self) -> Camera:
        """Camera of exactly this image size."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True)
class Picture:
    """A photograph reduced to the size masks are made at.

    Attributes:
        name: Name of the photograph.
        lab: (H, W, 3) float32, CIE L*a*b*; L in [0, 100].
        camera: Camera of this size.
    """

    name: str
    lab: Layer
    camera: Camera


def reduced(views: Sequence[Posed], side: int) -> list[Picture]:
    """Photographs at most `side` pixels long, for work on colours.

    Args:
        views: Photographs.
        side: Longer side in pixels.

    Returns:
        One picture each, in the same order.
    """
    pictures = []
    for view in views:
        camera = view.camera
        scale = min(1.0, side / max(camera.width, camera.height))
        size = (max(1, round(camera.width * scale)), max(1, round(camera.height * scale)))
        small = cv2.resize(view.image_display, size, interpolation=cv2.INTER_AREA)
        pictures.append(Picture(name=view.name, lab=to_lab(small), camera=camera.resized(*size)))
    return pictures


def to_lab(image_display: Bytes) -> Layer:
    """CIE L*a*b* of an 8-bit sRGB picture, float32."""
    return cv2.cvtColor(image_display.astype(np.float32) / np.float32(255), cv2.COLOR_RGB2LAB)


def sampled(layer: NDArray, pixels: Array) -> NDArray:
    """Values of a layer (H, W, ...) at the pixels nearest to image points (N, 2)."""
    column = np.clip(pixels[:, 0], 0, layer.shape[1] - 1).astype(np.int64)
    row = np.clip(pixels[:, 1], 0, layer.shape[0] - 1).astype(np.int64)
    return layer[row, column]
