# SPDX-License-Identifier: Apache-2.0
"""Rays through a photograph's pixels, and where they meet the ground."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from robir.capture.camera import Camera
from robir.geometry.ground.columns import Columns
from robir.geometry.lattice import Lattice
from robir.geometry.rays import Photo

SAMPLE_STEP = 2  # every so many pixels are looked at where a sample will do, along rows and columns
_LEAST_COVERAGE = 0.95  # above which a pixel may show ground


def pixels_of(camera: Camera, points: NDArray[np.float64], step: int = 1) -> NDArray[np.int64]:
    """Pixels in which a camera sees points if nothing hides them.

    Args:
        camera: The camera.
        points: (P, 3), unit frame.
        step: Only every so many pixels along rows and columns count.

    Returns:
        Flat indices (P,); -1 where a point lies outside the picture or behind the camera.
    """
    image, depth = camera.project(points)
    column, row = (np.floor(image / step).astype(np.int64) * step).T
    held = (depth > 0) & (column >= 0) & (row >= 0)
    held &= (column < camera.width) & (row < camera.height)
    return np.where(held, row * camera.width + column, -1)


class Solid:
    """What may block rays.

    Args:
        lattice: Nodes.
        inside: (N,) bool, the nodes that are solid.
    """

    def __init__(self, lattice: Lattice, inside: Tensor) -> None:
        self.lattice = lattice
        self.inside = inside
        self.is_empty = not bool(inside.any())
        grid = inside.view(lattice.shape).numpy()
        held = [np.flatnonzero(grid.any(axis=rest)) for rest in ((1, 2), (0, 2), (0, 1))]
        first = np.array([nodes[0] if len(nodes) else 0 for nodes in held])
        last = np.array([nodes[-1] if len(nodes) else 0 for nodes in held])
        # a node speaks for half a cell about it, one at the border for all that lies beyond
        low, high = (lattice.lower + lattice.cell * end for end in (first - 1.0, last + 1.0))
        self._low = np.where(first == 0, -np.inf, low)
        self._high = np.where(last == np.array(lattice.shape) - 1, np.inf, high)

    def crossed(
        self, origins: NDArray[np.float64], directions: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Distances (P,) at which rays (P, 3) enter and leave a box that holds what is solid."""
        inverse = 1.0 / np.where(np.abs(directions) < 1e-9, 1e-9, directions)
        one, two = (self._low - origins) * inverse, (self._high - origins) * inverse
        return np.minimum(one, two).max(axis=1), np.maximum(one, two).min(axis=1)

    def holds(self, points: Tensor) -> NDArray[np.bool_]:
        """Whether the nodes nearest to points (P, 3) are solid, (P,)."""
        return self.inside.index_select(0, self.lattice.nearest(points)).numpy()


class PixelRays:
    """Rays through a photograph's pixels and where they meet the ground's plane.

    Args:
        columns: Columns over the ground's plane.
        photo: The photograph.

    Attributes:
        column: (H W,) flat index of the column at whose foot a pixel's ray ends.
        meets: (H W,) bool, whether it ends at one; elsewhere `column` says nothing.
        sample: Flat indices of those covered pixels that are looked at where a sample will do.
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
        covered = photo.coverage.ravel() > _LEAST_COVERAGE
        self.meets = covered & falls & on_grid
        chosen = np.zeros(photo.coverage.shape, bool)
        chosen[::SAMPLE_STEP, ::SAMPLE_STEP] = True
        self.sample = np.flatnonzero(covered & chosen.ravel())

    def unblocked(self, solid: Solid, pixels: NDArray[np.int64]) -> NDArray[np.int64]:
        """Those of some pixels whose rays touch nothing solid above the plane.

        Args:
            solid: What may block them.
            pixels: Flat indices of pixels.

        Returns:
            Flat indices of pixels.
        """
        if solid.is_empty:
            return pixels
        cell = solid.lattice.cell
        origins, directions = self._origins[pixels], self._directions[pixels]
        middle = -(origins * directions).sum(1)
        end = self._reach[pixels] - cell / np.maximum(self._falling[pixels], 1e-6)
        end[~self.meets[pixels]] = np.inf
        steps = np.arange(-1.05, 1.05, cell)
        # only steps before the ground and near what is solid, one more on either side
        enter, leave = solid.crossed(origins, directions)
        zero = middle + steps[0]
        first = np.clip((enter - zero) / cell - 1.0, 0, len(steps)).astype(int)
        last = np.clip((np.minimum(leave, end) - zero) / cell + 2.0, 0, len(steps)).astype(int)
        count = np.maximum(last - first, 0)
        ray = np.repeat(np.arange(len(pixels)), count)
        number = np.arange(len(ray)) - np.repeat(np.cumsum(count) - count - first, count)
        distance = middle[ray] + steps[number]
        planes = [o[ray] + distance * d[ray] for o, d in zip(origins.T, directions.T, strict=True)]
        touches = solid.holds(torch.from_numpy(np.stack(planes)).float().T)
        blocked = np.zeros(len(pixels), bool)
        blocked[ray[touches & (distance < end[ray])]] = True
        return pixels[~blocked]
