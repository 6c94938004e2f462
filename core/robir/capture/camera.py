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

from robir.maths.similarity import Similarity

Array = NDArray[np.float64]

Box = tuple[int, int, int, int]  # left, top, right and bottom edge of a part, whole pixels


@dataclass(frozen=True, slots=True, kw_only=True)
class Camera:
    """A pinhole camera without lens distortion."""

    width: int  # image width in pixels
    height: int  # image height in pixels
    fx: float  # focal length along the row, pixels
    fy: float  # focal length along the column, pixels
    cx: float  # principal point from the left edge, pixels
    cy: float  # principal point from the top edge, pixels
    camera_to_world: Array  # 4x4 rigid transform, OpenGL axes
    # left, top, right and bottom edge of the photograph that this picture was cut from, in pixels
    # of the picture; None if it is the whole photograph. What lies between the picture's edges and
    # these is known to be background.
    whole: tuple[float, float, float, float] | None = None

    @property
    def position(self) -> Array:
        """Centre of projection, world, shape (3,)."""
        return self.camera_to_world[:3, 3]

    @property
    def forward(self) -> Array:
        """Viewing direction, unit, world, shape (3,)."""
        return -self.camera_to_world[:3, 2]

    @property
    def edges(self) -> tuple[float, float, float, float]:
        """Left, top, right and bottom edge of the whole photograph, pixels of this picture."""
        return self.whole or (0.0, 0.0, float(self.width), float(self.height))

    @property
    def whole_size(self) -> tuple[float, float]:
        """Width and height of the whole photograph, pixels of this picture."""
        left, top, right, bottom = self.edges
        return right - left, bottom - top

    def rays(self, pixels: Array) -> tuple[Array, Array]:
        """Origins and unit directions (N, 3), world, of rays through image points (N, 2)."""
        x, y = (pixels[:, 0] - self.cx) / self.fx, -(pixels[:, 1] - self.cy) / self.fy
        local = np.stack([x, y, -np.ones(len(pixels))], axis=1)
        directions = local @ self.camera_to_world[:3, :3].T
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        return np.broadcast_to(self.position, directions.shape).copy(), directions

    def pixel_centres(self) -> Array:
        """Centres of all pixels, row by row, shape (H * W, 2)."""
        rows, columns = np.mgrid[: self.height, : self.width]
        return np.stack([columns.ravel() + 0.5, rows.ravel() + 0.5], axis=1)

    def project(self, points: Array) -> tuple[Array, Array]:
        """Image points (N, 2) of points (N, 3), and depths (N,), negative behind the camera."""
        local = (points - self.position) @ self.camera_to_world[:3, :3]
        depth = -local[:, 2]
        safe = np.where(np.abs(depth) < 1e-12, 1e-12, depth)
        x = self.fx * local[:, 0] / safe + self.cx
        y = -self.fy * local[:, 1] / safe + self.cy
        return np.stack([x, y], axis=1), depth

    def in_picture(self, pixels: Array, depth: Array) -> NDArray[np.bool_]:
        """Which image points (N, 2) at depths (N,) the picture shows."""
        return (depth > 0) & ((pixels >= 0) & (pixels < (self.width, self.height))).all(axis=1)

    def in_photograph(self, pixels: Array, depth: Array) -> NDArray[np.bool_]:
        """Which image points (N, 2) at depths (N,) the whole photograph shows."""
        left, top, right, bottom = self.edges
        inside = (pixels >= (left, top)) & (pixels < (right, bottom))
        return (depth > 0) & inside.all(axis=1)

    def off_axis(self, pixels: Array) -> Array:
        """Squared distances (N,) of points (N, 2) from the lens's axis; a corner has 1 at most."""
        away = pixels - [self.cx, self.cy]
        width, height = self.whole_size
        return ((away**2).sum(1) * 4 / (width**2 + height**2)).clip(max=1.0)

    def part(self, box: Box) -> Camera:
        """The camera of a part of the picture."""
        left, top, right, bottom = box
        a, b, c, d = self.edges
        size = {"width": right - left, "height": bottom - top}
        whole = (a - left, b - top, c - left, d - top)
        return replace(self, **size, cx=self.cx - left, cy=self.cy - top, whole=whole)

    def uncut(self) -> Camera:
        """The camera of the whole photograph at the resolution of this picture."""
        if self.whole is None:
            return self
        left, top, _, _ = self.whole
        width, height = (max(1, round(side)) for side in self.whole_size)
        here = replace(self, cx=self.cx - left, cy=self.cy - top, whole=None)
        return replace(here, width=width, height=height)

    def cut_like(self, other: Camera) -> Camera:
        """This camera of a whole photograph, cut and reduced as another, of a part of it, was."""
        left, top, _, _ = other.edges
        wide, high = other.whole_size
        sx, sy = wide / self.width, high / self.height
        lens = {"fx": self.fx * sx, "fy": self.fy * sy}
        lens |= {"cx": self.cx * sx + left, "cy": self.cy * sy + top}
        return replace(other, **lens, camera_to_world=self.camera_to_world)

    def resized(self, width: int, height: int) -> Camera:
        """The same camera with another number of pixels over the same field of view."""
        sx, sy = width / self.width, height / self.height
        whole = self.whole
        if whole is not None:
            whole = (whole[0] * sx, whole[1] * sy, whole[2] * sx, whole[3] * sy)
        lens = {"fx": self.fx * sx, "fy": self.fy * sy, "cx": self.cx * sx, "cy": self.cy * sy}
        return replace(self, width=width, height=height, **lens, whole=whole)

    def normalised(self, centre: Array, radius: float) -> Camera:
        """The camera in the frame where the bounding sphere is the unit sphere at the origin."""
        pose = self.camera_to_world.copy()
        pose[:3, 3] = (pose[:3, 3] - centre) / radius
        return replace(self, camera_to_world=pose)

    def moved(self, place: Similarity) -> Camera:
        """The camera where a similarity that does not mirror brings it."""
        pose = self.camera_to_world.copy()
        pose[:3, :3] = place.turn @ pose[:3, :3]
        pose[:3, 3] = place(pose[None, :3, 3])[0]
        return replace(self, camera_to_world=pose)
