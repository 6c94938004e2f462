# SPDX-License-Identifier: Apache-2.0
"""Pinhole cameras in one convention: OpenGL/Blender axes, pixel centres at half integers.

Camera x points right, y up, and the camera looks along -z. A pixel (column i, row j, row 0 on top)
has its centre at (i + 0.5, j + 0.5). Readers convert to this at the border; nothing inside knows
another convention.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class Camera:
    """A pinhole camera without lens distortion.

    Attributes:
        width: Image width in pixels.
        height: Image height in pixels.
        fx: Focal length along the row, pixels.
        fy: Focal length along the column, pixels.
        cx: Principal point from the left edge, pixels.
        cy: Principal point from the top edge, pixels.
        camera_to_world: 4x4 rigid transform, OpenGL axes.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    camera_to_world: Array

    @property
    def position(self) -> Array:
        """Centre of projection, world, shape (3,)."""
        return self.camera_to_world[:3, 3]

    @property
    def forward(self) -> Array:
        """Viewing direction, unit, world, shape (3,)."""
        return -self.camera_to_world[:3, 2]

    def rays(self, pixels: Array) -> tuple[Array, Array]:
        """Rays through image points.

        Args:
            pixels: (N, 2) image points (x right, y down), pixel centres at half integers.

        Returns:
            Origins (N, 3) and unit directions (N, 3), world.
        """
        local = np.stack(
            [
                (pixels[:, 0] - self.cx) / self.fx,
                -(pixels[:, 1] - self.cy) / self.fy,
                -np.ones(len(pixels)),
            ],
            axis=1,
        )
        directions = local @ self.camera_to_world[:3, :3].T
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        return np.broadcast_to(self.position, directions.shape).copy(), directions

    def pixel_centres(self) -> Array:
        """Centres of all pixels, row by row, shape (H * W, 2)."""
        rows, columns = np.mgrid[: self.height, : self.width]
        return np.stack([columns.ravel() + 0.5, rows.ravel() + 0.5], axis=1)

    def project(self, points: Array) -> tuple[Array, Array]:
        """Image points of world points.

        Args:
            points: (N, 3), world.

        Returns:
            Image points (N, 2) and depths (N,) along the viewing direction; points behind the
            camera have a negative depth and a meaningless image point.
        """
        local = (points - self.position) @ self.camera_to_world[:3, :3]
        depth = -local[:, 2]
        safe = np.where(np.abs(depth) < 1e-12, 1e-12, depth)
        x = self.fx * local[:, 0] / safe + self.cx
        y = -self.fy * local[:, 1] / safe + self.cy
        return np.stack([x, y], axis=1), depth

    def off_axis(self, pixels: Array) -> Array:
        """Squared distances (N,) of points (N, 2), pixels, from the lens's axis.

        A corner's is 1 where the axis is in the middle of the picture; more counts as 1.
        """
        away = pixels - [self.cx, self.cy]
        return ((away**2).sum(1) * 4 / (self.width**2 + self.height**2)).clip(max=1.0)

    def resized(self, width: int, height: int) -> Camera:
        """The same camera with another number of pixels over the same field of view."""
        sx, sy = width / self.width, height / self.height
        return replace(
            self,
            width=width,
            height=height,
            fx=self.fx * sx,
            fy=self.fy * sy,
            cx=self.cx * sx,
            cy=self.cy * sy,
        )

    def normalised(self, centre: Array, radius: float) -> Camera:
        """The camera in the frame where the bounding sphere is the unit sphere at the origin."""
        pose = self.camera_to_world.copy()
        pose[:3, 3] = (pose[:3, 3] - centre) / radius
        return replace(self, camera_to_world=pose)
