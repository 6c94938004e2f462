# SPDX-License-Identifier: Apache-2.0
"""Where the object is, before any mask: the cameras' common focus, its points, what it stands on.

That photographs of an object are aimed at it is the fixation constraint of Campbell, Vogiatzis,
Hernandez and Cipolla 2010, "Automatic 3D object segmentation in multiple views using volumetric
graph-cuts".
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import ConvexHull, Delaunay, QhullError

from robir.capture.camera import Camera
from robir.capture.masks.sight import Array
from robir.capture.support import Plane, across, support_plane

# radius about the focus within which the object is looked for, against the cameras' distance
REACH = 1.0
LINK = 0.08  # points this near belong together, against the cameras' distance
DENSE = 0.1  # points of a cell that may belong to the object, against those of its densest cells
LEAST_POINTS = 25  # fewer points than this say nothing about the object's extent
# height of the lowest points over the plane, against the height of all, from which what carries
# them has not been seen
FLOATING = 0.15
FOOT = 0.5  # size of what then is looked for down on the plane, against the outline from above
BLIND = 0.2  # radius of the object against the cameras' distance, where no points tell it
ROOM = 0.6  # room left about the points of the object, against their largest extent


@dataclass(frozen=True, slots=True, kw_only=True)
class Region:
    """The box in which the object lies, and what is known of the object within.

    Attributes:
        centre: (3,), capture frame.
        axes: (3, 3) rows: unit axes of the box; the third points up where a plane is known.
        half: (3,) half the sides of the box.
        core: (K, 4) half spaces (normal, offset; inside <= 0) whose intersection is the convex
            hull of what is known of the object.
        points: (N, 3) surface points that belong to the object, possibly none.
        scale: Length over which belief fades outside the core, capture unit.
        plane: What the object stands on, or None.
        origin: How the region was found, one clause for the user.
    """

    centre: Array
    axes: Array
    half: Array
    core: Array
    points: Array
    scale: float
    plane: Plane | None
    origin: str

    def cells(self, count: int) -> tuple[Array, float]:
        """Cells of equal size that fill the box.

        Args:
            count: Cells along the longest side.

        Returns:
            Centres (N, 3), capture frame, and the side of a cell.
        """
        side = 2.0 * float(self.half.max()) / count
        number = np.maximum(np.ceil(2.0 * self.half / side - 1e-9).astype(int), 1)
        ticks = [side * (np.arange(n) - 0.5 * (n - 1)) for n in number]
        local = np.stack(np.meshgrid(*ticks, indexing="ij"), axis=-1).reshape(-1, 3)
        return local @ self.axes + self.centre, side

    def belief(self, points: Array) -> NDArray[np.float32]:
        """How likely points (N, 3) are to belong to the object before a pixel is looked at."""
        outside = np.full(len(points), -np.inf)
        for space in self.core:
            np.maximum(outside, points @ space[:3] + space[3], out=outside)
        fade = np.exp(-np.square(np.maximum(outside, 0.0) / self.scale))
        return (0.05 + 0.75 * fade).astype(np.float32)


def focus(cameras: Sequence[Camera]) -> tuple[Array, float] | None:
    """The point nearest to all viewing axes, outliers apart, and the cameras' distance to it.

    Args:
        cameras: Cameras.

    Returns:
        Point (3,) and median distance, or None where the axes are parallel or nothing lies ahead.
    """
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


def find_region(cameras: Sequence[Camera], points: Array) -> Region | None:
    """Region of the object the cameras aim at.

    Args:
        cameras: Cameras.
        points: (N, 3) sparse surface points, possibly none.

    Returns:
        The region, or None where the cameras have no common focus.
    """
    aim = focus(cameras)
    if aim is None:
        return None
    middle, distance = aim
    near = points[np.linalg.norm(points - middle, axis=1) < REACH * distance]
    plane = support_plane(near, cameras, distance)
    clump = _object_points(near, plane, middle, distance)
    own, foot = _down_to_plane(clump, near, plane)
    whole = np.concatenate([own, foot])
    core = _half_spaces(whole)
    origin = f"{len(own)} points about the cameras' common focus"
    if core is None:
        half = np.full(3, BLIND * distance)
        blind = middle + half * np.array(_CORNERS)
        core = _half_spaces_of_box(middle, half)
        return _around(blind, core, (plane, blind), "the cameras' common focus")
    return replace(_around(whole, core, (plane, clump), origin), points=own)


def region_of_box(box: Sequence[float], cameras: Sequence[Camera], points: Array) -> Region:
    """Region a user has given: an upright box.

    Args:
        box: Centre x, y, z and sides x, y, z, capture frame and unit.
        cameras: Cameras.
        points: (N, 3) sparse surface points, possibly none.

    Returns:
        The region; its box is the user's.
    """
    centre, half = np.array(box[:3]), 0.5 * np.array(box[3:])
    distance = float(np.median([np.linalg.norm(c.position - centre) for c in cameras]))
    near = points[np.linalg.norm(points - centre, axis=1) < max(REACH * distance, 2 * half.max())]
    plane = support_plane(near, cameras, distance)
    own = near[(np.abs(near - centre) <= half).all(axis=1)]
    if plane is not None:
        own = own[plane.height(own) > 2.0 * plane.tolerance]
    core = _half_spaces(own)
    if core is None:
        core = _half_spaces_of_box(centre, 0.6 * half)
    return Region(
        centre=centre,
        axes=np.eye(3),
        half=half,
        core=core,
        points=own,
        scale=float(half.max()),
        plane=plane,
        origin="the box that was given",
    )


_CORNERS = [[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]


def _object_points(points: Array, plane: Plane | None, middle: Array, distance: float) -> Array:
    """The clump of points that stands on the plane where the cameras aim."""
    if plane is not None:
        points = points[plane.height(points) > 2.0 * plane.tolerance]
    if len(points) < LEAST_POINTS:
        return points[:0]
    cell = LINK * distance
    index = np.floor((points - points.min(axis=0)) / cell).astype(int)
    grid = np.zeros(index.max(axis=0) + 1, dtype=np.int64)
    np.add.at(grid, tuple(index.T), 1)
    # the object is dense with points; what lies about it on the table joins it by stray ones
    dense = DENSE * np.quantile(grid[grid > 0], 0.9)
    pieces, count = ndimage.label(grid > max(dense, 1), np.ones((3, 3, 3)))
    piece = pieces[tuple(index.T)]
    pull = np.exp(-np.square(np.linalg.norm(points - middle, axis=1) / (0.25 * distance)))
    score = np.bincount(piece, pull, count + 1)
    score[0] = 0.0
    own = points[piece == score.argmax()] if count else points[:0]
    return own if len(own) >= LEAST_POINTS else points[:0]


def _down_to_plane(own: Array, points: Array, plane: Plane | None) -> tuple[Array, Array]:
    """The object's points with those below them, and where it may touch what it stands on.

    Nothing floats: below a clump that ends far above the plane there is more of the object, a
    plain leg or stem that few points show.

    Args:
        own: (N, 3) the clump.
        points: (M, 3) all points about it.
        plane: What the object stands on, or None.

    Returns:
        Points (N + B, 3) of the object, and (F, 3) that its extent takes in as well.
    """
    none = own[:0]
    if plane is None or len(own) == 0:
        return own, none
    height = plane.height(own)
    lowest, highest = np.quantile(height, [0.01, 0.99])
    if lowest < FLOATING * (highest - lowest):
        return own, none
    above = plane.height(points)
    shadow = own - height[:, None] * plane.normal
    about = points - above[:, None] * plane.normal
    middle = shadow.mean(axis=0)
    with suppress(QhullError, ValueError):
        flat = across(plane.normal).T
        outline = Delaunay((shadow - middle) @ flat)
        inside = outline.find_simplex((about - middle) @ flat) >= 0
        below = points[inside & (above > 2.0 * plane.tolerance) & (above < lowest)]
        return np.concatenate([own, below]), middle + FOOT * (shadow - middle)
    return own, none


def _half_spaces(points: Array) -> Array | None:
    """Convex hull of the points, without the outermost in each direction, as half spaces."""
    if len(points) == 0:
        return None
    if len(points) > 100:
        far = np.linalg.norm(points - np.median(points, axis=0), axis=1)
        points = points[far <= np.quantile(far, 0.98)]
    with suppress(QhullError, ValueError):
        equations = ConvexHull(points).equations
        return np.unique(np.round(equations, 9), axis=0)
    return None


def _half_spaces_of_box(centre: Array, half: Array) -> Array:
    """An upright box as half spaces."""
    normals = np.concatenate([np.eye(3), -np.eye(3)])
    return np.column_stack([normals, -normals @ centre - np.tile(half, 2)])


def _around(own: Array, core: Array, standing: tuple[Plane | None, Array], origin: str) -> Region:
    """A box about the object's points with room for what has no points.

    Args:
        own: (N, 3) points that the object takes in.
        core: As in `Region`.
        standing: What the object stands on, and the points (C, 3) whose extent says how much room.
        origin: As in `Region`.
    """
    plane, clump = standing
    up = np.array([0.0, 0.0, 1.0]) if plane is None else plane.normal
    axes = np.stack([*across(up), up])
    lower, upper = np.quantile(own @ axes.T, [0.01, 0.99], axis=0)
    extent = float(np.ptp(np.quantile(clump @ axes.T, [0.01, 0.99], axis=0), axis=0).max())
    lower, upper = lower - ROOM * extent, upper + ROOM * extent
    if plane is not None:
        lower[2] = max(lower[2], plane.offset)
    return Region(
        centre=0.5 * (lower + upper) @ axes,
        axes=axes,
        half=0.5 * (upper - lower),
        core=core,
        points=np.zeros((0, 3)),
        scale=0.5 * ROOM * extent,
        plane=plane,
        origin=origin,
    )
