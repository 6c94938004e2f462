# SPDX-License-Identifier: Apache-2.0
"""Bundle adjustment: cameras and points that fall where photographs show them.

The sum over all observations of log(1 + e^2), e in pixels, is lowered by Levenberg and Marquardt's
damped steps with Cauchy's weights. Points are eliminated from each step's equations first, as each
touches few cameras (Triggs et al. 2000, "Bundle adjustment: a modern synthesis", section 6). What
scipy's least_squares makes of the same equations does not get better at all: positions, turns and a
focal length differ too much in scale, and the frame is free.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from robir.capture.camera import Camera

Array = NDArray[np.float64]
Rows = NDArray[np.int64]

# of the first step, as a share of the diagonal, and what no step helps beyond
DAMPING, MOST_DAMPING = 1e-3, 1e6
ENOUGH = 1e-5  # share of the sum by which a step must lower it to be followed by another
# deviation of `zoom` in cameras that are a few pixels off, in units of a pixel's error: points of
# one thing hardly tell a focal length from a distance
ZOOM_SPREAD = 0.03
FLIP = np.array([1.0, -1.0])  # rows of a picture count downwards, a camera's y axis points up


@dataclass(frozen=True, slots=True, kw_only=True)
class Tracks:
    """Points that stand out, each found in several photographs.

    Attributes:
        view: (O,) photograph of each observation.
        point: (O,) point of each observation, from 0 without gaps.
        pixels: (O, 2) where it is seen.
    """

    view: Rows
    point: Rows
    pixels: Array

    def of(self, kept: NDArray[np.bool_]) -> Tracks:
        """The points kept (N,), numbered anew."""
        rows = kept[self.point]
        number = np.cumsum(kept) - 1
        return Tracks(
            view=self.view[rows], point=number[self.point[rows]], pixels=self.pixels[rows]
        )

    @property
    def count(self) -> int:
        """Number of points."""
        return int(self.point.max()) + 1 if len(self.point) else 0


@dataclass(frozen=True, slots=True, kw_only=True)
class Bundle:
    """Cameras as they are adjusted.

    Attributes:
        rotations: (V, 3, 3) world to camera.
        centres: (V, 3) world.
        focal: (V, 2) pixels.
        principal: (V, 2) pixels.
        zoom: Logarithm of the factor that focal lengths were multiplied by since they were given.
    """

    rotations: Array
    centres: Array
    focal: Array
    principal: Array
    zoom: float = 0.0

    @classmethod
    def of(cls, cameras: Sequence[Camera]) -> Bundle:
        """From cameras."""
        return cls(
            rotations=np.stack([camera.camera_to_world[:3, :3].T for camera in cameras]),
            centres=np.stack([camera.position for camera in cameras]),
            focal=np.array([[camera.fx, camera.fy] for camera in cameras]),
            principal=np.array([[camera.cx, camera.cy] for camera in cameras]),
        )

    def moved(self, step: Array) -> Bundle:
        """Turned, moved and zoomed.

        Args:
            step: (6 V + 1,) a rotation vector and a shift of each camera, and the logarithm of a
                factor on all focal lengths.
        """
        turn, shift = np.split(step[:-1].reshape(-1, 6), 2, axis=1)
        return replace(
            self,
            rotations=Rotation.from_rotvec(turn).as_matrix() @ self.rotations,
            centres=self.centres + shift,
            focal=self.focal * np.exp(step[-1]),
            zoom=self.zoom + float(step[-1]),
        )

    def aligned(self, other: Bundle) -> Bundle:
        """The same cameras in the frame where their centres lie nearest to those of another.

        Umeyama 1991, "Least-squares estimation of transformation parameters between two point
        patterns", eq. 40 to 42.
        """
        mean, wanted = self.centres.mean(0), other.centres.mean(0)
        own, its = self.centres - mean, other.centres - wanted
        left, spread, right = np.linalg.svd(its.T @ own)
        sign = np.array([1.0, 1.0, np.sign(np.linalg.det(left @ right))])
        turn = (left * sign) @ right
        scale = (spread * sign).sum() / (own**2).sum()
        return replace(
            self, rotations=self.rotations @ turn.T, centres=scale * own @ turn.T + wanted
        )

    def local(self, tracks: Tracks, points: Array) -> Array:
        """Points (O, 3) of all observations in the axes of their cameras."""
        away = points[tracks.point] - self.centres[tracks.view]
        return np.einsum("nij,nj->ni", self.rotations[tracks.view], away)

    def offsets(self, tracks: Tracks, points: Array) -> Array:
        """Where points fall, less where they are seen, (O, 2) pixels."""
        local = self.local(tracks, points)
        place = FLIP * local[:, :2] / _away(local)
        return place * self.focal[tracks.view] + self.principal[tracks.view] - tracks.pixels

    def errors(self, tracks: Tracks, points: Array) -> Array:
        """Lengths (O,) of `offsets`, pixels."""
        return np.linalg.norm(self.offsets(tracks, points), axis=1)

    def triangulated(self, tracks: Tracks) -> Array:
        """Points (N, 3) nearest to the rays of their observations."""
        place = FLIP * (tracks.pixels - self.principal[tracks.view]) / self.focal[tracks.view]
        local = np.column_stack([place, -np.ones(len(place))])
        ray = np.einsum("nij,ni->nj", self.rotations[tracks.view], local)
        ray /= np.linalg.norm(ray, axis=1, keepdims=True)
        across = np.eye(3) - ray[:, :, None] * ray[:, None, :]
        system, right = np.zeros((tracks.count, 3, 3)), np.zeros((tracks.count, 3))
        np.add.at(system, tracks.point, across)
        start = np.einsum("nij,nj->ni", across, self.centres[tracks.view])
        np.add.at(right, tracks.point, start)
        return np.linalg.solve(system + 1e-9 * np.eye(3), right[..., None])[..., 0]


def adjusted(
    bundle: Bundle, tracks: Tracks, points: Array, rounds: int, *, moves_cameras: bool
) -> tuple[Bundle, Array]:
    """Cameras and points of least robust error.

    Args:
        bundle: To begin with.
        tracks: Observations.
        points: (N, 3) to begin with.
        rounds: Steps at most.
        moves_cameras: Whether cameras move too, or points alone.

    Returns:
        The cameras, in a frame that may have drifted, and the points.
    """
    best, damping = _cost(bundle, tracks, points), DAMPING
    for _ in range(rounds):
        equations = _Equations(bundle, tracks, points, moves_cameras=moves_cameras)
        while True:
            step, shift = equations.step(damping)
            moved, there = bundle.moved(step), points + shift
            cost = _cost(moved, tracks, there)
            if cost < best:
                break
            damping *= 5
            if damping > MOST_DAMPING:
                return bundle, points
        gain, best = best - cost, cost
        bundle, points, damping = moved, there, max(damping / 5, 1e-9)
        if gain < ENOUGH * best:
            break
    return bundle, points


class _Equations:
    """Gauss and Newton's equations at a state, solved for any damping."""

    def __init__(
        self, bundle: Bundle, tracks: Tracks, points: Array, *, moves_cameras: bool
    ) -> None:
        self._cameras, count = len(bundle.centres), tracks.count
        offsets = bundle.offsets(tracks, points)
        weight = 1 / (1 + (offsets**2).sum(1))
        by_camera, by_point = _derivatives(bundle, tracks, points)
        rows = np.arange(2 * len(offsets)).reshape(-1, 2)
        root = np.sqrt(weight)[:, None, None]

        def sparse(values: Array, columns: Rows, width: int) -> scipy.sparse.csr_matrix:
            shape = values.shape
            place = (
                np.broadcast_to(rows[:, :, None], shape).ravel(),
                np.broadcast_to(columns[:, None], shape).ravel(),
            )
            return scipy.sparse.csr_matrix(
                ((root * values).ravel(), place), shape=(rows.size, width)
            )

        points_at = 3 * tracks.point[:, None] + np.arange(3)
        right = (root[..., 0] * offsets).ravel()
        b = sparse(by_point, points_at, 3 * count)
        self._blocks = np.zeros((count, 3, 3))
        np.add.at(
            self._blocks,
            tracks.point,
            weight[:, None, None] * np.einsum("nki,nkj->nij", by_point, by_point),
        )
        self._right_points = -(b.T @ right)
        self._mixed = None
        if moves_cameras:
            width = 6 * self._cameras + 1
            cameras_at = np.column_stack(
                [6 * tracks.view[:, None] + np.arange(6), np.full(len(offsets), width - 1)]
            )
            a = sparse(by_camera, cameras_at, width)
            self._square = (a.T @ a).toarray()
            self._right_cameras = -(a.T @ right)
            self._square[-1, -1] += ZOOM_SPREAD**-2
            self._right_cameras[-1] -= bundle.zoom * ZOOM_SPREAD**-2
            self._mixed = (a.T @ b).tocsr()

    def step(self, damping: float) -> tuple[Array, Array]:
        """Steps of the cameras, as for `Bundle.moved`, and shifts (N, 3) of the points."""
        count = len(self._blocks)
        damped = self._blocks * (1 + damping * np.eye(3)) + 1e-12 * np.eye(3)
        inverse = np.linalg.inv(damped)
        cameras = np.zeros(6 * self._cameras + 1)
        right = self._right_points
        if self._mixed is not None:
            diagonal = scipy.sparse.bsr_matrix(
                (inverse, np.arange(count), np.arange(count + 1)), shape=(3 * count, 3 * count)
            ).tocsr()
            through = self._mixed @ diagonal
            system = self._square - (through @ self._mixed.T).toarray()
            system += damping * np.diag(np.diag(self._square))
            # the frame is free, so that the least of all solutions is meant
            cameras = np.linalg.lstsq(system, self._right_cameras - through @ right, rcond=1e-12)[0]
            right = right - self._mixed.T @ cameras
        return cameras, np.einsum("nij,nj->ni", inverse, right.reshape(-1, 3))


def _derivatives(bundle: Bundle, tracks: Tracks, points: Array) -> tuple[Array, Array]:
    """Of the image points by a camera's step (O, 2, 7) and by the point (O, 2, 3)."""
    local, focal = bundle.local(tracks, points), bundle.focal[tracks.view]
    place = local[:, :2] / _away(local)
    by_local = np.zeros((len(local), 2, 3))
    by_local[:, 0, 0] = by_local[:, 1, 1] = 1.0
    by_local[:, :, 2] = place
    by_local *= (FLIP * focal)[:, :, None] / _away(local)[:, :, None]
    turn = np.zeros((len(local), 3, 3))  # of the local point by a rotation vector
    turn[:, 0, 1], turn[:, 0, 2], turn[:, 1, 2] = local[:, 2], -local[:, 1], local[:, 0]
    turn -= turn.transpose(0, 2, 1)
    by_point = by_local @ bundle.rotations[tracks.view]
    by_focal = (FLIP * place * focal)[:, :, None]
    return np.concatenate([by_local @ turn, -by_point, by_focal], axis=2), by_point


def _away(local: Array) -> Array:
    """Distances (O, 1) along the viewing direction, never 0."""
    depth = -local[:, 2:]
    return np.where(np.abs(depth) < 1e-9, 1e-9, depth)


def _cost(bundle: Bundle, tracks: Tracks, points: Array) -> float:
    errors = np.log1p((bundle.offsets(tracks, points) ** 2).sum(1)).sum()
    return float(errors) + (bundle.zoom / ZOOM_SPREAD) ** 2
