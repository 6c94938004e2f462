# SPDX-License-Identifier: Apache-2.0
"""Rays through a photograph's pixels, and where they meet the ground."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from robir.geometry.columns import Columns
from robir.geometry.lattice import Lattice
from robir.geometry.rays import Photo

PIXEL_STEP = 2
"""Every so many pixels are looked at where a sample will do, along rows and columns."""


class PixelRays:
    """Rays through a photograph's pixels and where they meet the ground's plane.

    Args:
        columns: Columns over the ground's plane.
        photo: The photograph.

    Attributes:
        column: (H W,) flat index of the column at whose foot a pixel's ray ends.
        meets: (H W,) bool, whether it ends at one; elsewhere `column` says nothing.
        sample: Flat indices of every PIXEL_STEP-th covered pixel.
    """

    def __init__(self, columns: Columns, photo: Photo) -> None:
        origins, directions = photo.camera.rays(photo.camera.pixel_centres())
        self._origins = np.broadcast_to(origins, directions.shape).reshape(-1, 3)
        self._directions = directions.reshape(-1, 3)
        start = columns.plane.local(self._origins)
        self._falling = -self._directions @ columns.plane.axes[2]
        falls = self._falling > 1e-6
        self._reach = start[:, 2] / np.where(falls, self._falling, 1.0)
        spot = columns.plane.local(self._origins + self._reach[:, None] * self._directions)
        node = np.round((spot[:, :2] - columns.low) / columns.spacing)
        on_grid = ((node >= 0) & (node < columns.shape)).all(1)
        node = np.where(on_grid[:, None], node, 0).astype(int)
        self.column = node[:, 0] * columns.shape[1] + node[:, 1]
        covered = photo.coverage.ravel() > 0.95
        self.meets = covered & falls & on_grid
        chosen = np.zeros(photo.coverage.shape, bool)
        chosen[::PIXEL_STEP, ::PIXEL_STEP] = True
        self.sample = np.flatnonzero(covered & chosen.ravel())

    def unblocked(
        self, lattice: Lattice, inside: Tensor, pixels: NDArray[np.int64]
    ) -> NDArray[np.int64]:
        """Those of some pixels whose rays touch nothing solid above the plane.

        Args:
            lattice: Nodes.
            inside: (N,) bool, the nodes that are solid.
            pixels: Flat indices of pixels.

        Returns:
            Flat indices of pixels.
        """
        origins, directions = self._origins[pixels], self._directions[pixels]
        middle = -(origins * directions).sum(1, keepdims=True)
        distance = middle + np.arange(-1.05, 1.05, lattice.cell)
        points = origins[:, None] + distance[..., None] * directions[:, None]
        solid = inside[lattice.nearest(torch.from_numpy(points.reshape(-1, 3)).float())]
        end = self._reach[pixels] - lattice.cell / np.maximum(self._falling[pixels], 1e-6)
        above = (distance < end[:, None]) | ~self.meets[pixels, None]
        return pixels[~(solid.view(len(pixels), -1).numpy() & above).any(1)]
