# SPDX-License-Identifier: Apache-2.0
"""Masks of photographs on a backdrop of one colour: whatever else they show is the object.

Renderings without alpha and photographs that were cut out are of this kind. What the object stands
on is in front of the backdrop too and belongs to it, as it does where alpha says so. A patch of the
backdrop's colour that the object encloses is a hole where nothing along its rays is of another
colour in the other photographs, or else a dark or a white part of the object.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from robir.capture.camera import Camera
from robir.capture.capture import View
from robir.capture.images.opencv import cv2
from robir.capture.masks.guess import Array, Layer, sampled
from robir.capture.masks.region import focus

RING = 2  # width of the strip along the edges of a photograph that shows the backdrop, pixels
FLAT = 2  # codes by which a backdrop varies at most; no wall varies so little unless clipped
RINGING = 16  # the same about an object in a JPEG file: its blocks of 8 pixels carry edges over
BARE = 0.9  # share of all edges that the backdrop covers at least; the object may run out of some
LEAST, MOST = 0.002, 0.9  # share of the photographs that an object covers, in the median
LEAST_HOLE = 4  # pixels of an enclosed patch that is looked at
RAYS, STEPS = 24, 96  # rays through each enclosed patch, and points looked at along each
CARVED = 2  # other photographs that must see the backdrop through a point for it to be empty
NEAR_RIM = 3.0  # pixels from a rim within which the object's own colour is read


def backdrop_masks(views: Sequence[View], *, is_lossy: bool) -> tuple[Layer, ...] | None:
    """Share (H, W) of pixels that the object covers before one backdrop of all, or None."""
    edges = np.concatenate([_strip(view.image_display) for view in views]).astype(np.int16)
    colour = np.median(edges, axis=0).astype(np.int16)
    if (np.abs(edges - colour).max(axis=1) <= FLAT).mean() < BARE:
        return None
    limit = RINGING if is_lossy else FLAT
    alike = [np.abs(view.image_display - colour).max(axis=2) <= limit for view in views]
    # number of the connected piece of every pixel of the backdrop's colour, else 0
    parts = [cv2.connectedComponents(a.astype(np.uint8), connectivity=4)[1] for a in alike]
    outside = [near & np.isin(each, _strip(each)) for near, each in zip(alike, parts, strict=True)]
    shares = [1.0 - float(each.mean()) for each in outside]
    if not LEAST < np.median(shares) < MOST:
        return None
    enclosed = [near & ~each for near, each in zip(alike, outside, strict=True)]
    behind = _with_holes(outside, enclosed, parts, [view.camera for view in views])
    return tuple(
        _coverage(view.image_display - colour, each)
        for view, each in zip(views, behind, strict=True)
    )


def _strip(picture: NDArray) -> NDArray:
    """Values (N, ...) of a picture (H, W, ...) along its edges."""
    parts = (picture[:RING], picture[:, :RING], picture[-RING:], picture[:, -RING:])
    return np.concatenate([part.reshape(-1, *picture.shape[2:]) for part in parts])


def _with_holes(
    outside: list[NDArray[np.bool_]],
    enclosed: list[NDArray[np.bool_]],
    parts: list[NDArray[np.int32]],
    cameras: list[Camera],
) -> list[NDArray[np.bool_]]:
    """The backdrop of each photograph with those enclosed patches that are holes."""
    aim = focus(cameras)
    if aim is None:
        return outside
    rng = np.random.default_rng(0)
    behind = []
    for index, (own, patches) in enumerate(zip(outside, enclosed, strict=True)):
        whole = own.copy()
        for piece in np.flatnonzero(np.bincount(parts[index][patches]) >= LEAST_HOLE):
            inside = parts[index] == piece
            rows = np.argwhere(inside)
            rows = rows[rng.choice(len(rows), min(RAYS, len(rows)), replace=False)]
            points = _along(cameras[index], rows, aim[0])
            others = [k for k in range(len(cameras)) if k != index]
            if _is_empty(points, others, (outside, enclosed), cameras).mean() > 0.5:
                whole |= inside
        behind.append(whole)
    return behind


def _along(camera: Camera, rows: NDArray[np.int64], middle: Array) -> Array:
    """Points (N, STEPS, 3) on the rays through pixels (row, column) (N, 2), about the focus."""
    origins, directions = camera.rays(rows[:, ::-1] + 0.5)
    distance = float(np.linalg.norm(camera.position - middle))
    depth = distance * np.linspace(0.3, 1.7, STEPS)
    return origins[:, None] + depth[:, None] * directions[:, None]


def _is_empty(
    points: Array,
    others: list[int],
    behind: tuple[list[NDArray[np.bool_]], list[NDArray[np.bool_]]],
    cameras: list[Camera],
) -> NDArray[np.bool_]:
    """Whether nothing stands on rays (N, STEPS, 3), by what the other photographs show there."""
    flat = points.reshape(-1, 3)
    seen, beyond, through = (np.zeros(len(flat), int) for _ in range(3))
    for index in others:
        pixels, depth = cameras[index].project(flat)
        known = cameras[index].in_picture(pixels, depth)
        seen += known
        beyond += known & sampled(behind[0][index], pixels)
        through += known & sampled(behind[1][index], pixels)
    free = (beyond > 0) | (through >= CARVED) | (seen == 0)
    return free.reshape(points.shape[:2]).all(axis=1)


def _coverage(apart: NDArray[np.int16], behind: NDArray[np.bool_]) -> Layer:
    """Share (H, W) of pixels that the object covers; a rim mixes its colour and the backdrop's."""
    near = cv2.dilate(behind.astype(np.uint8), np.ones((3, 3), np.uint8)) == 1
    rim, within = near & ~behind, ~near
    covered = (~behind).astype(np.float32)
    if not within.any() or not rim.any():
        return covered
    distance, nearest = ndimage.distance_transform_edt(~within, return_indices=True)
    rows, columns = np.nonzero(rim & (distance < NEAR_RIM))
    mixed = apart[rows, columns].astype(np.float32)
    own = apart[nearest[0][rows, columns], nearest[1][rows, columns]].astype(np.float32)
    size = (own**2).sum(axis=1)
    share = (mixed * own).sum(axis=1) / np.maximum(size, 1.0)
    is_known = size > (4 * FLAT) ** 2
    covered[rows, columns] = np.where(is_known, np.clip(share, 0.0, 1.0), 1.0)
    return covered
