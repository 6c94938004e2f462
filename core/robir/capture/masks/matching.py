# SPDX-License-Identifier: Apache-2.0
"""Sparse surface points of photographs with known poses, where a capture brings none.

Features are SIFT (Lowe 2004, "Distinctive image features from scale-invariant keypoints") compared
as RootSIFT (Arandjelovic and Zisserman 2012). With the poses known, a match only has to lie on the
epipolar line, so that points are triangulated pair by pair, without any adjustment.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robir.capture.camera import Camera
from robir.capture.images.opencv import cv2
from robir.capture.masks.sight import Array, Posed

SIDE = 800  # longer side at which features are looked for, pixels
MAX_VIEWS = 48  # photographs used at most, evenly spread over their order
FEATURES = 2000  # features used of a photograph at most, the strongest
NEIGHBOURS = 3  # photographs each photograph is compared with
RATIO = 0.8  # greatest distance of the best match against the second best
OFF_LINE = 1.2  # pixels a triangulated point may lie beside its features


@dataclass(frozen=True, slots=True, kw_only=True)
class Features:
    """What stands out in a photograph.

    Attributes:
        name: Name of the photograph.
        camera: Camera of the size the features were found at.
        pixels: (N, 2) image points.
        words: (N, 128) unit descriptors.
    """

    name: str
    camera: Camera
    pixels: Array
    words: NDArray[np.float32]


def features(views: Sequence[Posed], most: int = FEATURES) -> list[Features]:
    """Find what stands out in photographs.

    Args:
        views: Photographs with cameras.
        most: Features used of a photograph at most, the strongest.

    Returns:
        One value a photograph, those without features left out.
    """
    sift = cv2.SIFT_create(nfeatures=most, contrastThreshold=0.02)
    found = []
    for view in views:
        scale = min(1.0, SIDE / max(view.camera.width, view.camera.height))
        size = (max(1, round(view.camera.width * scale)), max(1, round(view.camera.height * scale)))
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


def triangulated(found: Sequence[Features]) -> Array:
    """Surface points that neighbouring photographs agree on.

    Args:
        found: Features of the photographs.

    Returns:
        (N, 3) points, capture frame; possibly none.
    """
    chosen = pairs([each.camera for each in found], NEIGHBOURS)
    points = [_points(found[one], found[two]) for one, two in chosen]
    return np.concatenate(points) if points else np.zeros((0, 3))


def pairs(cameras: Sequence[Camera], neighbours: int) -> list[tuple[int, int]]:
    """Pairs of cameras that look at much the same from a little apart.

    Args:
        cameras: Of the photographs.
        neighbours: Photographs each photograph is compared with.
    """
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


def matches(one: Features, two: Features) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Rows (M,) of the features of two photographs that are each other's best and stand apart."""
    likeness = one.words @ two.words.T
    best = likeness.argmax(axis=1)
    is_mutual = likeness.argmax(axis=0)[best] == np.arange(len(best))
    top = np.sort(np.partition(likeness, -2, axis=1)[:, -2:], axis=1)
    distance = np.sqrt(np.maximum(2.0 - 2.0 * top, 0.0))
    kept = np.flatnonzero(is_mutual & (distance[:, 1] < RATIO * distance[:, 0]))
    return kept, best[kept]


def _points(one: Features, two: Features) -> Array:
    """Triangulated matches of two photographs, (N, 3)."""
    at, origin, towards = [], [], []
    for each, index in zip((one, two), matches(one, two), strict=True):
        start, direction = each.camera.rays(each.pixels[index])
        at.append(each.pixels[index])
        origin.append(start)
        towards.append(direction)
    cosine = (towards[0] * towards[1]).sum(axis=1)
    across = np.maximum(1.0 - cosine**2, 1e-12)
    apart = origin[1] - origin[0]
    along = [(apart * direction).sum(axis=1) for direction in towards]
    reach_one = (along[0] - cosine * along[1]) / across
    reach_two = (cosine * along[0] - along[1]) / across
    points = 0.5 * (
        origin[0] + reach_one[:, None] * towards[0] + origin[1] + reach_two[:, None] * towards[1]
    )
    good = (reach_one > 0) & (reach_two > 0) & (cosine < np.cos(np.radians(2.0)))
    for each, pixels in zip((one, two), at, strict=True):
        shown, depth = each.camera.project(points)
        good &= (depth > 0) & (np.linalg.norm(shown - pixels, axis=1) < OFF_LINE)
    return points[good]
