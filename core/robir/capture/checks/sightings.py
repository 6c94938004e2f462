# SPDX-License-Identifier: Apache-2.0
"""Points of the object and how bright each photograph shows them, before there is a surface.

The points lie on the visual hull of the masks, which is good enough to compare one point between
photographs in the median: where the hull stands off the object, single points go wrong.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from robir.capture.capture import Bounds, View
from robir.capture.frames import Array
from robir.capture.images.loading import resize_view

POWER = 2.2  # of display values, that stands for the tone curve while it is not known
SIDE = 400  # longer side of the photographs that are looked at, pixels, at most
_GRID = 40
_POINTS = 1500
_FRONTAL = 0.3  # cosine to the view direction from which a hull's normal is worth something
_DARKEST = 0.02


@dataclass(frozen=True, slots=True, kw_only=True)
class Sightings:
    """Brightness of P points in V photographs.

    Attributes:
        brightness: (P, V) in steps (log2), NaN where a photograph does not show the point.
        normals: (P, V, 3) unit normals in the frame of each camera.
    """

    brightness: Array
    normals: Array

    def of(self, points: NDArray[np.bool_]) -> Sightings:
        """The same for some of the points."""
        return Sightings(brightness=self.brightness[points], normals=self.normals[points])


def sight(views: Sequence[View], bounds: Bounds) -> Sightings:
    """Look at points of the visual hull in all photographs.

    Args:
        views: Photographs with masks.
        bounds: The object's sphere.

    Returns:
        What was seen, of about 1500 points at most.
    """
    views = [resize_view(view, SIDE) for view in views]
    inside = _hull(views, bounds)
    half = bounds.radius / _GRID
    cells = np.argwhere(inside & ~ndimage.binary_erosion(inside))
    cells = cells[:: max(1, len(cells) // _POINTS)]
    slope = np.gradient(ndimage.gaussian_filter(inside.astype(np.float64), 1.5))
    normals = -np.stack([part[tuple(cells.T)] for part in slope], axis=1)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9)
    points = bounds.centre + half * (2 * cells + 1 - _GRID)
    brightness = np.full((len(points), len(views)), np.nan)
    turned = np.zeros((len(points), len(views), 3))
    for number, view in enumerate(views):
        turned[:, number] = normals @ view.camera.camera_to_world[:3, :3]
        towards = view.camera.position - points
        towards /= np.linalg.norm(towards, axis=1, keepdims=True)
        seen = (normals * towards).sum(axis=1) > _FRONTAL
        for step in np.arange(2.5, 0.75 * _GRID):
            along = np.rint(cells + step * towards).astype(np.int64)
            within = ((along >= 0) & (along < _GRID)).all(axis=1)
            seen &= ~(within & inside[tuple(np.clip(along, 0, _GRID - 1).T)])
        row, column, framed, _ = _pixels(view, points)
        seen &= framed & (view.mask[row, column] >= 250)
        grey = ((view.image_display / 255.0) ** POWER).mean(axis=2)
        grey = ndimage.gaussian_filter(grey, 0.7 * max(1.0, view.camera.width / 120))
        brightness[seen, number] = np.log2(grey[row, column][seen] + _DARKEST)
    return Sightings(brightness=brightness, normals=turned)


def _pixels(
    view: View, points: Array
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.bool_], NDArray[np.bool_]]:
    """Row and column of points, and whether they are in the picture and in the photograph."""
    camera = view.camera
    pixels, depth = camera.project(points)
    limits = (camera.width - 1, camera.height - 1)
    column, row = np.clip(pixels, 0, limits).astype(np.int64).T
    return row, column, camera.in_picture(pixels, depth), camera.in_photograph(pixels, depth)


def _hull(views: Sequence[View], bounds: Bounds) -> NDArray[np.bool_]:
    """Cells of a cube about the sphere that at most a twentieth of the masks call background."""
    ticks = np.linspace(-1 + 1 / _GRID, 1 - 1 / _GRID, _GRID) * bounds.radius
    grid = np.stack(np.meshgrid(ticks, ticks, ticks, indexing="ij"), axis=-1).reshape(-1, 3)
    seen, against = np.zeros(len(grid)), np.zeros(len(grid))
    for view in views:
        row, column, framed, known = _pixels(view, grid + bounds.centre)
        seen += known
        against += known & ~(framed & (view.mask[row, column] >= 64))
    kept = (seen >= 0.25 * len(views)) & (against <= 0.05 * seen)
    return kept.reshape(_GRID, _GRID, _GRID)
