# SPDX-License-Identifier: Apache-2.0
"""Masks from photographs with poses alone: GrabCut in each, and a common volume, in turns.

Each round cuts every photograph by its colours and edges (GrabCut: Rother, Kolmogorov and Blake
2004) and carves the volume that nearly all cuts allow; its picture in each photograph is where the
next round expects the object, as in Campbell et al. 2010. Sparse points of the object lie in it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from robir.capture.bounds import kept, shown, silhouette
from robir.capture.camera import Camera
from robir.capture.capture import View
from robir.capture.images.loading import size_within
from robir.capture.images.opencv import cv2
from robir.capture.masks.region import Region
from robir.workers import blocks, side_by_side

Array = NDArray[np.float64]
Bytes = NDArray[np.uint8]
Layer = NDArray[np.float32]
Mask = NDArray[np.bool_]

SIDE = 320  # longer side at which masks are made, pixels
DISSENT = 0.05  # share of the photographs that may call a part background in the end
# longer side of the pictures, and that share, round by round
_ROUNDS = ((SIDE // 2, 0.15), (SIDE // 2, 0.10), (SIDE // 2, 0.07), (SIDE, DISSENT))
CELLS = 64  # along the longest side of the region
_SLIM = 0.6  # of a cell that masks carve and pictures show: whole ones would make it fat
_ROOM = 0.0375  # of the side beyond the volume's picture is looked at after the first round
_DEEP = 4  # pixels within it from which it is believed against the colours in the end
_CONTAINED = 0.85  # share of the masks that must contain a surface point of the object
# share of the points on a plane that masks contain from which it is a side of the object: of six
# tables it was at most 0.16, of two sides 0.46 and 0.93
_OWN = 0.3
_RING = 10  # pixels on both sides of an outline by which colours are judged
_LEAST_CONTRAST = 0.65  # below this object and background look too alike
_LEAST_AGREEMENT = 0.75  # below this the masks show no common object
_LEAST, _MOST = 0.002, 0.9  # share of the photographs that an object covers, in the median
_ODD = 0.6  # agreement below which a single mask is named
_TOGETHER = 16  # photographs between two reports of progress
_SLACK = 6.0  # pixels by which the outline of a surface may be off
_BAND = 3  # small pixels on both sides of an outline that are looked at anew in the photograph
_FINE_SIDE = 640  # longer side of what is looked at then, pixels


@dataclass(frozen=True, slots=True)
class Picture:
    """A photograph reduced to the size masks are made at: CIE L*a*b* (H, W, 3) uint8, camera."""

    lab: Bytes
    camera: Camera


@dataclass(frozen=True, slots=True, kw_only=True)
class Guess:
    """Masks and how far they are to be trusted."""

    masks: tuple[Layer, ...]  # (H, W) float32, 1 on the object, at most `SIDE` long
    agreement: Array  # (V,) intersection over union of each mask with the volume all masks allow
    # (V,) share of the pixels along each outline that colours learnt from the other photographs put
    # on the right side; one half where object and background look alike
    contrast: Array
    region: Region  # where the object was looked for
    is_own_table: bool  # whether the plane it should stand on is a side of its own

    def fault(self) -> str | None:
        """Why the masks are not to be trusted, a clause for the user, or None."""
        share = np.median([mask.mean() for mask in self.masks])
        contrast, agreement = (float(np.median(x)) for x in (self.contrast, self.agreement))
        if share < _LEAST:
            return "nothing stands out from the background where the cameras aim"
        if share > _MOST:
            return "everything the cameras see looks like the object"
        if contrast < _LEAST_CONTRAST:
            return (
                "object and background look alike: along the outlines found, colour puts only "
                f"{100 * contrast:.0f} % of the pixels on the right side"
            )
        if agreement < _LEAST_AGREEMENT:
            what = "what was cut out of the photographs has no common shape"
            return f"{what}: it agrees to {100 * agreement:.0f} %"
        return None

    @property
    def odd(self) -> Mask:
        """(V,) which masks do not agree with the others."""
        return self.agreement < _ODD


def guess_masks(views: Sequence[View], region: Region, progress: Callable[[float], None]) -> Guess:
    """Cut the object of a region out of photographs; `progress` hears the share of the work."""
    cells, half = region.cells(CELLS)
    left, size, points = cells[region.is_core(cells)], half, region.points
    pictures: list[Picture] = []
    masks: list[Mask] = []
    priors: list[Mask] = []
    alike: list[Mask] = []
    for number, (side, dissent) in enumerate(_ROUNDS):
        if number == 0 or side != _ROUNDS[number - 1][0]:
            pictures = reduced(views, side)
            priors = [shown(p.camera, left, size) for p in pictures]
            alike = _like_points(pictures, region.points, priors)
        if number:
            about = _disc(round(_ROOM * side))
            rooms = [cv2.dilate(prior.astype(np.uint8), about) == 1 for prior in priors]
        else:
            rooms = [shown(p.camera, cells, half) for p in pictures]
        masks, cut = [], partial(_cut, points=points)
        items = list(zip(pictures, priors, rooms, alike, strict=True))
        for part in blocks(len(items), _TOGETHER):
            masks += side_by_side(cut, items[part])
            progress((number + len(masks) / len(pictures)) / len(_ROUNDS))
        outlines = [
            silhouette(p.camera, m) for p, m in zip(pictures, masks, strict=True) if m.any()
        ]
        size = _SLIM * half
        left = cells[kept(outlines, cells, size, round(dissent * len(outlines)))]
        priors = [shown(p.camera, left, size) for p in pictures]
        points = _within(region.points, pictures, masks)
    agreement = [(m & p).sum() / max((m | p).sum(), 1) for m, p in zip(masks, priors, strict=True)]
    # one hole drills through the whole visual hull, so what all others see is put back
    deep = [cv2.erode(p.astype(np.uint8), _disc(_DEEP), borderValue=1) == 1 for p in priors]
    masks = [mask | inner for mask, inner in zip(masks, deep, strict=True)]
    return Guess(
        masks=tuple(mask.astype(np.float32) for mask in masks),
        agreement=np.array(agreement),
        contrast=_contrasts([picture.lab for picture in pictures], masks),
        region=region,
        is_own_table=len(_within(region.table, pictures, masks)) > _OWN * len(region.table),
    )


def _cut(item: tuple[Picture, Mask, Mask, Mask], points: Array) -> Mask:
    """Object pixels of a photograph by where it may be, must not be, and looks like its points."""
    picture, prior, room, own = item
    labels = np.where(prior, cv2.GC_PR_FGD, cv2.GC_PR_BGD).astype(np.uint8)
    labels[~room] = cv2.GC_BGD
    is_sure = _near_points(picture.camera, points) | (own & prior)
    labels[is_sure & room] = cv2.GC_FGD
    return _grabbed(picture.lab, labels)


def reduced(views: Sequence[View], side: int) -> list[Picture]:
    """Photographs at most `side` pixels long, in the same order."""
    pictures = []
    for view in views:
        camera = view.camera
        size = size_within((camera.width, camera.height), side)
        small = cv2.resize(view.image_display, size, interpolation=cv2.INTER_AREA)
        pictures.append(Picture(cv2.cvtColor(small, cv2.COLOR_RGB2LAB), camera.resized(*size)))
    return pictures


def recut(pictures: Sequence[Picture], outlines: Sequence[Layer]) -> list[Layer]:
    """Masks (H, W) cut again near a surface's outline, at signed distances (H, W), pixels."""

    def cut(pair: tuple[Picture, Layer]) -> Layer:
        picture, outline = pair
        labels = np.where(outline < 0, cv2.GC_PR_FGD, cv2.GC_PR_BGD).astype(np.uint8)
        labels[outline < -_SLACK], labels[outline > _SLACK] = cv2.GC_FGD, cv2.GC_BGD
        return _grabbed(picture.lab, labels).astype(np.float32)

    return side_by_side(cut, zip(pictures, outlines, strict=True))


def sharpened(image_display: Bytes, belief: Layer) -> Bytes:
    """Mask (H, W), 255 inside, along a photograph's edges, by a belief (h, w) in [0, 1]."""
    height, width = image_display.shape[:2]
    small = _without_crumbs(belief > 0.5)
    mask = np.zeros((height, width), np.uint8)
    if small.shape == mask.shape:
        return np.where(small, np.uint8(255), mask)
    if not small.any():
        return mask
    # only the part of the photograph about the object
    left, top, wide, high = cv2.boundingRect(small.astype(np.uint8))
    low = np.maximum([top - 4, left - 4], 0)
    high_end = np.minimum([top + high + 4, left + wide + 4], small.shape)
    scale = np.array([height, width]) / small.shape
    (y0, x0), (y1, x1) = np.rint(low * scale).astype(int), np.rint(high_end * scale).astype(int)
    part = image_display[y0:y1, x0:x1]
    own = small[low[0] : high_end[0], low[1] : high_end[1]].astype(np.float32)
    size = size_within((part.shape[1], part.shape[0]), _FINE_SIDE)
    inside = (cv2.resize(own, size, interpolation=cv2.INTER_LINEAR) > 0.5).astype(np.uint8)
    square = _disc(max(1, round(_BAND * max(size) / max(own.shape))))
    labels = np.where(inside, cv2.GC_PR_FGD, cv2.GC_PR_BGD).astype(np.uint8)
    labels[cv2.erode(inside, square) == 1] = cv2.GC_FGD
    labels[cv2.dilate(inside, square) == 0] = cv2.GC_BGD
    lab = cv2.cvtColor(cv2.resize(part, size, interpolation=cv2.INTER_AREA), cv2.COLOR_RGB2LAB)
    fine = _grabbed(lab, labels).astype(np.float32)
    fine = cv2.resize(fine, part.shape[1::-1], interpolation=cv2.INTER_LINEAR)
    mask[y0:y1, x0:x1] = np.where(fine > 0.5, 255, 0)
    return mask


def _disc(radius: int) -> Bytes:
    return cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1, 2 * radius + 1))


def _grabbed(lab: Bytes, labels: Bytes) -> Mask:
    """Object pixels by GrabCut, whose labels of the object are the odd ones."""
    if 0 < int((labels % 2).sum()) < labels.size:
        cv2.setRNGSeed(0)  # of the first clusters of colours
        models = np.zeros((1, 65)), np.zeros((1, 65))
        cv2.grabCut(lab, labels, None, *models, 1, cv2.GC_INIT_WITH_MASK)
    return labels % 2 == 1


def _near_points(camera: Camera, points: Array) -> Mask:
    """Pixels of the object's surface points, even hidden ones; one on its own may be a mistake."""
    pixels, depth = camera.project(points)
    column, row = pixels[camera.in_picture(pixels, depth)].astype(np.int64).T
    count = np.zeros((camera.height, camera.width), dtype=np.float32)
    np.add.at(count, (row, column), 1)
    near = cv2.boxFilter(count, -1, (5, 5), normalize=False, borderType=cv2.BORDER_CONSTANT)
    return (near > 1.5) & (count > 0)


def _like_points(pictures: Sequence[Picture], points: Array, priors: Sequence[Mask]) -> list[Mask]:
    """Pixels of colours that points of the object have, twice as often as what lies beyond."""
    cells = [_colours(picture.lab) for picture in pictures]
    counts = np.zeros(4096)
    for picture, own in zip(pictures, cells, strict=True):
        near = _near_points(picture.camera, points).astype(np.uint8)
        counts += np.bincount(own[cv2.dilate(near, _disc(1)) == 1], minlength=4096)
    alike = []
    for own, prior in zip(cells, priors, strict=True):
        beyond = np.bincount(own[~prior], minlength=4096)
        is_own = counts / max(counts.sum(), 1) > 2 * beyond / max(beyond.sum(), 1)
        alike.append(cv2.medianBlur(is_own[own].astype(np.uint8), 5) == 1)
    return alike


def _colours(lab: Bytes) -> NDArray[np.int64]:
    """Number of each pixel's cell of a histogram of 4096."""
    return (lab // 16).astype(np.int64) @ np.array([256, 16, 1])


def _within(points: Array, pictures: Sequence[Picture], masks: Sequence[Mask]) -> Array:
    """Points that nearly all masks contain."""
    inside, seen = np.zeros(len(points)), np.zeros(len(points))
    for picture, mask in zip(pictures, masks, strict=True):
        pixels, depth = picture.camera.project(points)
        known = picture.camera.in_picture(pixels, depth)
        inside += known & sampled(mask, pixels)
        seen += known
    return points[inside >= _CONTAINED * np.maximum(seen, 1)]


def sampled(layer: NDArray, pixels: Array) -> NDArray:
    """Values of a layer (H, W, ...) at the pixels nearest to image points (N, 2)."""
    column = np.clip(pixels[:, 0], 0, layer.shape[1] - 1).astype(np.int64)
    row = np.clip(pixels[:, 1], 0, layer.shape[0] - 1).astype(np.int64)
    return layer[row, column]


def _contrasts(labs: Sequence[Bytes], masks: Sequence[Mask]) -> Array:
    """Shares of the pixels along outlines whose colour is on the right side, by the others (V,)."""
    sides = []
    for lab, mask in zip(labs, masks, strict=True):
        cells = _colours(lab)
        inside = mask.astype(np.uint8)
        within = mask & (cv2.erode(inside, _disc(_RING), borderValue=1) == 0)
        beyond = ~mask & (cv2.dilate(inside, _disc(_RING)) == 1)
        sides.append([np.bincount(cells[part], minlength=4096) for part in (within, beyond)])
    counts = np.array(sides, np.float64)
    others = counts.sum(axis=0) - counts + 1e-3
    others /= others.sum(axis=2, keepdims=True)
    is_object = others[:, 0] > others[:, 1]
    right = np.stack([(counts[:, 0] * is_object).sum(1), (counts[:, 1] * ~is_object).sum(1)])
    totals = counts.sum(axis=2).T
    return np.where(totals.min(axis=0) > 0, (right / np.maximum(totals, 1)).mean(axis=0), 0.5)


def _without_crumbs(mask: Mask) -> Mask:
    """A mask without pieces and holes of less than a thousandth of it."""
    least = max(4.0, 1e-3 * float(mask.sum()))
    for inside in (True, False):
        layer = (mask == inside).astype(np.uint8)
        _, pieces, facts, _ = cv2.connectedComponentsWithStats(layer, connectivity=8)
        small = facts[:, cv2.CC_STAT_AREA] < least
        mask = np.where((layer == 1) & small[pieces], not inside, mask)
    return mask
