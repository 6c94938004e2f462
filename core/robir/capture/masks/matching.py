# SPDX-License-Identifier: Apache-2.0
"""Points that stand out, followed through photographs with known poses.

Features are SIFT (Lowe 2004, "Distinctive image features from scale-invariant keypoints") compared
as RootSIFT (Arandjelovic and Zisserman 2012). With poses known, a match has to lie on its epipolar
line, and points are triangulated without any adjustment.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from robir.capture.camera import Camera
from robir.capture.capture import View
from robir.capture.images.loading import size_within
from robir.capture.images.opencv import cv2
from robir.capture.masks.guess import Array

Rows = NDArray[np.int64]

SIDE = 800  # longer side at which features are looked for, pixels
MAX_VIEWS = 48  # photographs used at most to look for surface points, evenly spread
FEATURES = 2000  # features used of a photograph at most, the strongest
NEIGHBOURS = 3  # photographs each photograph is compared with
_RATIO = 0.8  # greatest distance of the best match against the second best
_OFF_LINE = 0.01  # longer sides from its epipolar line, beyond which a match is another point
_OFF_POINT = 1.2  # pixels a triangulated point may lie beside its features
_LEAST_ANGLE = 2.0  # degrees between the outermost rays of a surface point


@dataclass(frozen=True, slots=True, kw_only=True)
class Features:
    """What stands out in a photograph."""

    name: str  # name of the photograph
    camera: Camera  # camera of the size the features were found at
    pixels: Array  # (N, 2) image points
    words: NDArray[np.float32]  # (N, 128) unit descriptors


@dataclass(frozen=True, slots=True, kw_only=True)
class Tracks:
    """Points that stand out, each found in several photographs."""

    view: Rows  # (O,) photograph of each observation
    point: Rows  # (O,) point of each observation, from 0 without gaps
    pixels: Array  # (O, 2) where it is seen

    def of(self, kept: NDArray[np.bool_]) -> Tracks:
        """The points kept (N,), numbered anew."""
        rows = kept[self.point]
        point = (np.cumsum(kept) - 1)[self.point[rows]]
        return Tracks(view=self.view[rows], point=point, pixels=self.pixels[rows])

    @property
    def count(self) -> int:
        """Number of points."""
        return int(self.point.max()) + 1 if len(self.point) else 0


def features(views: Sequence[View], most: int = FEATURES) -> list[Features]:
    """What stands out in photographs, those without features left out."""
    sift = cv2.SIFT_create(nfeatures=most, contrastThreshold=0.02)
    found = []
    for view in views:
        size = size_within((view.camera.width, view.camera.height), SIDE)
        grey = cv2.cvtColor(view.image_display, cv2.COLOR_RGB2GRAY)
        grey = cv2.resize(grey, size, interpolation=cv2.INTER_AREA)
        points, words = sift.detectAndCompute(grey, None)
        if len(points) < 8:
            continue
        pixels = np.array([point.pt for point in points]) + 0.5
        words = np.sqrt(words / np.maximum(words.sum(axis=1, keepdims=True), 1e-9))
        camera = view.camera.resized(*size)
        found.append(Features(name=view.name, camera=camera, pixels=pixels, words=words))
    return found


def followed(found: Sequence[Features], shortest: int, neighbours: int = NEIGHBOURS) -> Tracks:
    """Points that are seen in at least `shortest` photographs, none twice in one."""
    starts = np.cumsum([0, *(len(each.pixels) for each in found)])
    first, second = [np.zeros(0, np.int64)], [np.zeros(0, np.int64)]
    for one, two in _pairs([each.camera for each in found], neighbours):
        own, its = _matches(found[one], found[two])
        near = _off_line(found[one], found[two], own, its) < _OFF_LINE
        first.append(starts[one] + own[near])
        second.append(starts[two] + its[near])
    ends = np.concatenate(first), np.concatenate(second)
    total = int(starts[-1])
    links = coo_array((np.ones(len(ends[0])), ends), shape=(total, total))
    number, label = connected_components(links, directed=False)
    view = np.repeat(np.arange(len(found)), np.diff(starts))
    length = np.bincount(label, minlength=number)
    # two features of one photograph cannot be one point
    places = np.unique(label.astype(np.int64) * len(found) + view) // max(len(found), 1)
    good = (length >= shortest) & (np.bincount(places, minlength=number) == length)
    rows = np.flatnonzero(good[label])
    pixels = np.concatenate([each.pixels for each in found]) if found else np.zeros((0, 2))
    point = np.unique(label[rows], return_inverse=True)[1].reshape(-1)
    return Tracks(view=view[rows], point=point, pixels=pixels[rows])


def triangulated(cameras: Sequence[Camera], tracks: Tracks) -> Array:
    """Points (N, 3) nearest to the rays of their observations."""
    origin, ray = _rays(cameras, tracks)
    across = np.eye(3) - ray[:, :, None] * ray[:, None, :]
    system, right = np.zeros((tracks.count, 3, 3)), np.zeros((tracks.count, 3))
    np.add.at(system, tracks.point, across)
    np.add.at(right, tracks.point, np.einsum("nij,nj->ni", across, origin))
    return np.linalg.solve(system + 1e-9 * np.eye(3), right[..., None])[..., 0]


def errors(cameras: Sequence[Camera], tracks: Tracks, points: Array) -> Array:
    """Pixels (O,) between where points fall and where they are seen; infinite behind a camera."""
    result = np.full(len(tracks.view), np.inf)
    for number, camera in enumerate(cameras):
        own = np.flatnonzero(tracks.view == number)
        pixels, depth = camera.project(points[tracks.point[own]])
        away = np.linalg.norm(pixels - tracks.pixels[own], axis=1)
        result[own] = np.where(depth > 0, away, np.inf)
    return result


def surface_points(found: Sequence[Features]) -> Array:
    """Surface points (N, 3), capture frame, that neighbouring photographs agree on."""
    cameras = [each.camera for each in found]
    tracks = followed(found, 2)
    if not tracks.count:
        return np.zeros((0, 3))
    points = triangulated(cameras, tracks)
    worst = np.zeros(tracks.count)
    np.maximum.at(worst, tracks.point, errors(cameras, tracks, points))
    _, rays = _rays(cameras, tracks)
    mean = np.zeros((tracks.count, 3))
    np.add.at(mean, tracks.point, rays)
    mean /= np.linalg.norm(mean, axis=1, keepdims=True)
    nearest = np.ones(tracks.count)
    np.minimum.at(nearest, tracks.point, (rays * mean[tracks.point]).sum(axis=1))
    is_wide = nearest < np.cos(np.radians(0.5 * _LEAST_ANGLE))
    return points[is_wide & (worst < _OFF_POINT)]


def _rays(cameras: Sequence[Camera], tracks: Tracks) -> tuple[Array, Array]:
    """Origins and unit directions (O, 3) of the observations."""
    origin, ray = np.zeros((len(tracks.view), 3)), np.zeros((len(tracks.view), 3))
    for number, camera in enumerate(cameras):
        own = tracks.view == number
        origin[own], ray[own] = camera.rays(tracks.pixels[own])
    return origin, ray


def _pairs(cameras: Sequence[Camera], neighbours: int) -> list[tuple[int, int]]:
    """Pairs of cameras that look at much the same from a little apart."""
    if len(cameras) < 2:
        return []
    place = np.stack([camera.position for camera in cameras])
    forward = np.stack([camera.forward for camera in cameras])
    apart = np.linalg.norm(place[:, None] - place[None], axis=2)
    turn = np.degrees(np.arccos(np.clip(forward @ forward.T, -1, 1)))
    # about 12 degrees apart is far enough to triangulate and near enough to match
    cost = np.abs(turn - 12.0) + 1e3 * (turn > 40.0)
    cost = np.where(apart > 1e-9 * apart.max(), cost, np.inf)
    np.fill_diagonal(cost, np.inf)
    chosen = set()
    for one in range(len(cameras)):
        for two in np.argsort(cost[one], kind="stable")[:neighbours]:
            if np.isfinite(cost[one, two]):
                chosen.add((min(one, int(two)), max(one, int(two))))
    return sorted(chosen)


def _matches(one: Features, two: Features) -> tuple[Rows, Rows]:
    """Rows (M,) of the features of two photographs that are each other's best and stand apart."""
    likeness = one.words @ two.words.T
    best = likeness.argmax(axis=1)
    is_mutual = likeness.argmax(axis=0)[best] == np.arange(len(best))
    top = np.sort(np.partition(likeness, -2, axis=1)[:, -2:], axis=1)
    distance = np.sqrt(np.maximum(2.0 - 2.0 * top, 0.0))
    rows = np.flatnonzero(is_mutual & (distance[:, 1] < _RATIO * distance[:, 0]))
    return rows, best[rows]


def _off_line(one: Features, two: Features, own: Rows, its: Rows) -> Array:
    """Angles between matched rays' planes through both centres, as shares of a longer side."""
    start, ray = one.camera.rays(one.pixels[own])
    end, other = two.camera.rays(two.pixels[its])
    normal = np.cross(ray, end - start)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    camera = two.camera
    return np.abs((normal * other).sum(1)) * camera.fx / max(camera.width, camera.height)
