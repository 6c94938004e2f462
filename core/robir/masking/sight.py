# SPDX-License-Identifier: Apache-2.0
"""What this room asks of a photograph: pixels and a pinhole camera, without lens distortion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from robir.masking.opencv import cv2

Array = NDArray[np.float64]
Layer = NDArray[np.float32]
Bytes = NDArray[np.uint8]


class Camera(Protocol):
    """A pinhole camera; pixel centres lie at half integers, depth grows away from it."""

    @property
    def width(self) -> int:
        """Pixels of a row."""
        ...

    @property
    def height(self) -> int:
        """Pixels of a column."""
        ...

    @property
    def fx(self) -> float:
        """Focal length along the row, pixels."""
        ...

    @property
    def fy(self) -> float:
        """Focal length along the column, pixels."""
        ...

    @property
    def position(self) -> Array:
        """Centre of projection, world, (3,)."""
        ...

    @property
    def forward(self) -> Array:
        """Viewing direction, unit, world, (3,)."""
        ...

    def project(self, points: Array) -> tuple[Array, Array]:
        """Image points (N, 2) and depths (N,) of world points (N, 3)."""
        ...

    def rays(self, pixels: Array) -> tuple[Array, Array]:
        """Origins (N, 3) and unit directions (N, 3), world, of image points (N, 2)."""
        ...

    def resized(self, width: int, height: int) -> Camera:
        """The same camera with another number of pixels."""
        ...


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


def in_frame(camera: Camera, pixels: Array, depth: Array) -> NDArray[np.bool_]:
    """Which projected points lie in the picture and before the camera."""
    return (depth > 0) & ((pixels >= 0) & (pixels < (camera.width, camera.height))).all(axis=1)


def sampled(layer: NDArray, pixels: Array) -> NDArray:
    """Values of a layer (H, W, ...) at the pixels nearest to image points (N, 2)."""
    column = np.clip(pixels[:, 0], 0, layer.shape[1] - 1).astype(np.int64)
    row = np.clip(pixels[:, 1], 0, layer.shape[0] - 1).astype(np.int64)
    return layer[row, column]
