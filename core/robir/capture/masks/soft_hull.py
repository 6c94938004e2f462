# SPDX-License-Identifier: Apache-2.0
"""The soft visual hull: what all masks together allow, and its picture in each photograph.

A cell is left to the object as long as nearly all photographs that see it do; the votes are soft,
as in Djelouah et al. 2015, "Sparse multi-view consistency for object segmentation".
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from robir.capture.camera import Camera
from robir.capture.images.opencv import cv2
from robir.capture.masks.region import Region
from robir.capture.masks.sight import Array, Layer, sampled

CELLS = 72  # cells along the longest side of the region
SEEN = 0.3  # share of the photographs that must have a cell in frame
DOUBT = 0.45  # belief in the outermost pixels of the hull's picture at most
COARSE = 2  # pixels of a mask along one pixel of the hull's picture


class Volume:
    """Cells of the region with the belief that they belong to the object.

    Args:
        region: Where the object is looked for.
        cameras: Cameras of the masks.

    Attributes:
        belief: (N,) float32 in [0, 1].
    """

    def __init__(self, region: Region, cameras: Sequence[Camera]) -> None:
        self.cells, self.side = region.cells(CELLS)
        if region.plane is not None:
            standing = region.plane.height(self.cells) > 0.25 * self.side
            self.cells = self.cells[standing]
        self.belief = region.belief(self.cells)
        self._cameras = list(cameras)

    def carve(self, masks: Sequence[Layer], dissent: float) -> None:
        """Take the belief from the masks.

        Args:
            masks: Belief of each photograph, (H, W) in [0, 1].
            dissent: Share of the photographs that may call a cell background at belief one half.
        """
        against = np.zeros(len(self.cells), dtype=np.float32)
        seen = np.zeros(len(self.cells), dtype=np.float32)
        for camera, mask in zip(self._cameras, masks, strict=True):
            pixels, depth = camera.project(self.cells)
            known = camera.in_picture(pixels, depth)
            width = self._footprint(camera, depth)
            wide = cv2.dilate(mask, np.ones((width, width), np.uint8))
            against += known * np.clip(1 - 2 * sampled(wide, pixels), 0, 1)
            seen += known
        share = against / np.maximum(seen, 1)
        allowed = max(dissent, 0.7 / len(masks))
        self.belief = np.exp(-np.log(2) * np.square(share / allowed)).astype(np.float32)
        self.belief[seen < SEEN * len(masks)] = 0

    def picture(self, index: int) -> Layer:
        """Greatest belief along the rays of a photograph, (H, W)."""
        camera = self._cameras[index]
        kept = self.belief > 0.02
        pixels, depth = camera.project(self.cells[kept])
        inside = camera.in_picture(pixels, depth)
        small = np.zeros(
            (-(-camera.height // COARSE), -(-camera.width // COARSE)), dtype=np.float32
        )
        column, row = (pixels[inside] / COARSE).astype(np.int64).T
        np.maximum.at(small, (row, column), self.belief[kept][inside])
        width = self._footprint(camera, depth[inside]) // COARSE + 1
        width += 1 - width % 2
        square = np.ones((width, width), np.uint8)
        filled = cv2.morphologyEx(small, cv2.MORPH_CLOSE, square)
        # cells are as wide as their footprint, so only what is left of it shrunk is certain
        sure = cv2.erode(filled, square, borderValue=1.0)
        bounded = np.where(sure > 0.5, filled, np.minimum(filled, np.float32(DOUBT)))
        return cv2.resize(bounded, (camera.width, camera.height), interpolation=cv2.INTER_LINEAR)

    def _footprint(self, camera: Camera, depth: Array) -> int:
        """Odd number of pixels that a cell covers."""
        ahead = depth[depth > 0]
        if len(ahead) == 0:
            return 1
        width = self.side * max(camera.fx, camera.fy) / float(np.median(ahead))
        return 2 * int(np.clip(round(0.5 * width), 1, 12)) + 1

    def points(self) -> NDArray[np.float64]:
        """Cells that belong to the object, (N, 3)."""
        return self.cells[self.belief > 0.5]
