# SPDX-License-Identifier: Apache-2.0
"""The plane an object stands on, from sparse surface points."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robir.capture.camera import Camera
from robir.maths.similarity import Similarity

Array = NDArray[np.float64]

TOLERANCE = 0.008  # distance from the plane of points on it, against the cameras' distance
PATCH = 0.05  # side of the patches by which points are counted, against the cameras' distance
TRIPLES = 1500  # planes tried
LEAST_PATCHES = 12  # patches a support plane must hold points in
BELOW = 0.25  # greatest share of patches below a support plane, against those on it


@dataclass(frozen=True, slots=True, kw_only=True)
class Plane:
    """What the object stands on."""

    normal: Array  # (3,) unit, towards the cameras
    offset: float  # points p on the plane have normal . p = offset.
    tolerance: float  # how far points on it may lie off it, capture unit

    def height(self, points: Array) -> Array:
        """Height of points (N, 3) above the plane."""
        return points @ self.normal - self.offset

    def normalised(self, centre: Array, radius: float) -> Plane:
        """The plane in the frame where a sphere is the unit sphere at the origin."""
        offset = float(self.offset - self.normal @ centre) / radius
        return Plane(normal=self.normal, offset=offset, tolerance=self.tolerance / radius)

    def moved(self, place: Similarity) -> Plane:
        """The plane where a similarity that does not mirror brings it."""
        normal = place.turn @ self.normal
        return Plane(
            normal=normal,
            offset=float(place.scale * self.offset + normal @ place.shift),
            tolerance=place.scale * self.tolerance,
        )


def across(normal: Array) -> Array:
    """Two unit axes (2, 3) along a plane of that unit normal."""
    first = np.cross(normal, np.eye(3)[np.abs(normal).argmin()])
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(normal, first)])


def support_plane(points: Array, cameras: Sequence[Camera], distance: float) -> Plane | None:
    """The plane with most points (N, 3) on it, next to none below, by Fischler and Bolles 1981."""
    if len(points) < 2 * LEAST_PATCHES:
        return None
    eyes = np.stack([camera.position for camera in cameras])
    tolerance = TOLERANCE * distance
    # by patches, so that a printed label does not outvote a bare table; lone points are mistakes
    patch = np.floor(points / (PATCH * distance)).astype(np.int64)
    _, of_point, count = np.unique(patch, axis=0, return_inverse=True, return_counts=True)
    kept = count[of_point.ravel()] > 1
    points, patch = points[kept], patch[kept]
    _, first = np.unique(patch, axis=0, return_index=True)
    if len(first) < LEAST_PATCHES:
        return None
    generator = np.random.default_rng(0)
    best, best_score = None, float(LEAST_PATCHES)
    for triple in points[first][generator.integers(len(first), size=(TRIPLES, 3))]:
        normal = np.cross(triple[1] - triple[0], triple[2] - triple[0])
        length = np.linalg.norm(normal)
        if length < 1e-2 * distance**2:
            continue
        plane = _facing(normal / length, triple[0], eyes, tolerance)
        score = _score(plane, points, patch, eyes)
        if score > best_score:
            best, best_score = plane, score
    for _ in range(5):
        if best is None:
            break
        on = points[np.abs(best.height(points)) < tolerance]
        middle = on.mean(axis=0)
        _, _, axes = np.linalg.svd(on - middle, full_matrices=False)
        best = _facing(axes[2], middle, eyes, tolerance)
    return best


def _facing(normal: Array, point: Array, eyes: Array, tolerance: float) -> Plane:
    """The plane through a point, its normal towards most cameras."""
    if np.median((eyes - point) @ normal) < 0:
        normal = -normal
    return Plane(normal=normal, offset=float(normal @ point), tolerance=tolerance)


def _score(plane: Plane, points: Array, patch: NDArray[np.int64], eyes: Array) -> float:
    """Patches with points on a plane less those below; 0 if cameras are below it."""
    if (plane.height(eyes) < 3 * plane.tolerance).mean() > 0.02:
        return 0.0
    height = plane.height(points)
    on = len(np.unique(patch[np.abs(height) < plane.tolerance], axis=0))
    below = len(np.unique(patch[height < -3.0 * plane.tolerance], axis=0))
    return 0.0 if below > BELOW * on else on - 2.0 * below
