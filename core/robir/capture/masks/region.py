# SPDX-License-Identifier: Apache-2.0
"""Where the object is, before any mask: the cameras' common focus, its points, what it stands on.

That photographs of an object are aimed at it is the fixation constraint of Campbell, Vogiatzis,
Hernandez and Cipolla 2010, "Automatic 3D object segmentation in multiple views using volumetric
graph-cuts".
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import ConvexHull, QhullError

from robir.capture.camera import Camera
from robir.capture.support import Plane, support_plane

Array = NDArray[np.float64]

_REACH = 1.0  # radius about the focus that is searched, against the cameras' distance
_LINK = 0.08  # points this near belong together, against the cameras' distance
_DENSE = 0.1  # points of a cell of the object at least, against those of its densest cells
_LEAST_POINTS = 25  # fewer points than this say nothing about the object's extent
_BLIND = 0.2  # half side of the object against the cameras' distance, where no points tell it
# height of the lowest points over the plane, against that of all, from which what carries them has
# not been seen, and the size of what then is looked for on the plane, against all from above
_FLOATING, _FOOT = 0.15, 0.5
_ROOM = 0.6  # room left about the points of the object, against their largest extent


@dataclass(frozen=True, slots=True)
class Region:
    """The upright box in which the object lies, and what is known of the object within."""

    centre: Array  # (3,), capture frame
    half: Array  # (3,) half the sides of the box
    core: Array  # (K, 4) half spaces (normal, offset; inside <= 0): convex hull of what is known
    points: Array  # (N, 3) surface points that belong to the object, possibly none
    plane: Plane | None  # what the object stands on, or None
    table: Array  # (M, 3) surface points on that plane, possibly none
    origin: str  # how the region was found, one clause for the user

    def cells(self, count: int) -> tuple[Array, float]:
        """Centres (N, 3) of `count` cells a longest side, above the plane, and half a side."""
        side = 2.0 * float(self.half.max()) / count
        number = np.maximum(np.ceil(2.0 * self.half / side - 1e-9).astype(int), 1)
        ticks = [side * (np.arange(n) - 0.5 * (n - 1)) for n in number]
        cells = np.stack(np.meshgrid(*ticks, indexing="ij"), axis=-1).reshape(-1, 3) + self.centre
        if self.plane is not None:
            cells = cells[self.plane.height(cells) > 0.25 * side]
        return cells, 0.5 * side

    def is_core(self, points: Array) -> NDArray[np.bool_]:
        """Which points (N, 3) lie in the core."""
        inside = np.ones(len(points), bool)
        for space in self.core:
            inside &= points @ space[:3] + space[3] <= 0
        return inside


def focus(cameras: Sequence[Camera]) -> tuple[Array, float] | None:
    """The point (3,) nearest to most viewing axes, and the cameras' distance to it; or None."""
    place = np.stack([camera.position for camera in cameras])
    forward = np.stack([camera.forward for camera in cameras])
    across = np.eye(3) - forward[:, :, None] * forward[:, None]
    weight = np.ones(len(cameras))
    point = place.mean(axis=0)
    for _ in range(10):
        system = (weight[:, None, None] * across).sum(axis=0)
        if np.linalg.cond(system) > 1e6:
            return None
        point = np.linalg.solve(system, (weight[:, None, None] * across @ place[..., None]).sum(0))
        point = point[:, 0]
        miss = np.linalg.norm((across @ (point - place)[..., None])[..., 0], axis=1)
        weight = 1.0 / np.maximum(miss, 0.1 * np.median(miss) + 1e-12)
        weight /= weight.max()
    ahead = ((point - place) * forward).sum(axis=1)
    if np.median(ahead) <= 0:
        return None
    return point, float(np.median(np.linalg.norm(place - point, axis=1)))


def find_region(cameras: Sequence[Camera], points: Array, *, stands: bool = True) -> Region | None:
    """Region of the object the cameras aim at, by sparse points (N, 3), or None without a focus.

    What the object `stands` on is looked for too.
    """
    aim = focus(cameras)
    if aim is None:
        return None
    middle, distance = aim
    near = points[np.linalg.norm(points - middle, axis=1) < _REACH * distance]
    plane = support_plane(near, cameras, distance) if stands else None
    table = _on(plane, near)
    own = _object_points(near, plane, middle, distance)
    whole = np.concatenate([own, _foot(own, plane)])
    core = _half_spaces(whole)
    if core is None:
        half = np.full(3, _BLIND * distance)
        core, own = _half_spaces_of_box(middle, half), own[:0]
        half, origin = (1 + 2 * _ROOM) * half, "the cameras' common focus"
        return Region(middle, half, core, own, plane, table, origin)
    room = _ROOM * float(np.ptp(np.quantile(own, [0.01, 0.99], axis=0), axis=0).max())
    lower, upper = np.quantile(whole, [0.01, 0.99], axis=0)
    half = 0.5 * (upper - lower) + room
    origin = f"{len(own)} points about the cameras' common focus"
    return Region(0.5 * (lower + upper), half, core, own, plane, table, origin)


def region_of_box(
    box: Sequence[float], cameras: Sequence[Camera], points: Array, *, stands: bool = True
) -> Region:
    """Region of a user's upright box: centre x, y, z and sides; sparse points (N, 3) or none."""
    centre, half = np.array(box[:3]), 0.5 * np.array(box[3:])
    distance = float(np.median([np.linalg.norm(c.position - centre) for c in cameras]))
    near = points[np.linalg.norm(points - centre, axis=1) < max(_REACH * distance, 2 * half.max())]
    plane = support_plane(near, cameras, distance) if stands else None
    own = near[(np.abs(near - centre) <= half).all(axis=1)]
    if plane is not None:
        own = own[plane.height(own) > 2.0 * plane.tolerance]
    core = _half_spaces(own)
    core = _half_spaces_of_box(centre, 0.6 * half) if core is None else core
    return Region(centre, half, core, own, plane, _on(plane, near), "the box that was given")


def _on(plane: Plane | None, points: Array) -> Array:
    return points[:0] if plane is None else points[np.abs(plane.height(points)) < plane.tolerance]


def _object_points(points: Array, plane: Plane | None, middle: Array, distance: float) -> Array:
    """The clump of points that stands on the plane where the cameras aim."""
    if plane is not None:
        points = points[plane.height(points) > 2.0 * plane.tolerance]
    if len(points) < _LEAST_POINTS:
        return points[:0]
    cell = _LINK * distance
    index = np.floor((points - points.min(axis=0)) / cell).astype(int)
    grid = np.zeros(index.max(axis=0) + 1, dtype=np.int64)
    np.add.at(grid, tuple(index.T), 1)
    # the object is dense with points; what lies about it on the table joins it by stray ones
    dense = _DENSE * np.quantile(grid[grid > 0], 0.9)
    pieces, count = ndimage.label(grid > max(dense, 1), np.ones((3, 3, 3)))
    piece = pieces[tuple(index.T)]
    pull = np.exp(-np.square(np.linalg.norm(points - middle, axis=1) / (0.25 * distance)))
    score = np.bincount(piece, pull, count + 1)
    score[0] = 0.0
    own = points[piece == score.argmax()] if count else points[:0]
    return own if len(own) >= _LEAST_POINTS else points[:0]


def _foot(own: Array, plane: Plane | None) -> Array:
    """Where an object whose points end far above the plane may touch it: nothing floats."""
    if plane is None or len(own) == 0:
        return own[:0]
    height = plane.height(own)
    lowest, highest = np.quantile(height, [0.01, 0.99])
    if lowest < _FLOATING * (highest - lowest):
        return own[:0]
    shadow = own - height[:, None] * plane.normal
    return shadow.mean(axis=0) + _FOOT * (shadow - shadow.mean(axis=0))


def _half_spaces(points: Array) -> Array | None:
    """Convex hull of the points, without the outermost in each direction, as half spaces."""
    if len(points) == 0:
        return None
    if len(points) > 100:
        far = np.linalg.norm(points - np.median(points, axis=0), axis=1)
        points = points[far <= np.quantile(far, 0.98)]
    with suppress(QhullError, ValueError):
        return np.unique(np.round(ConvexHull(points).equations, 9), axis=0)
    return None


def _half_spaces_of_box(centre: Array, half: Array) -> Array:
    """An upright box as half spaces."""
    normals = np.concatenate([np.eye(3), -np.eye(3)])
    return np.column_stack([normals, -normals @ centre - np.tile(half, 2)])
