# SPDX-License-Identifier: Apache-2.0
"""Guessed masks made better by the surface that photographs show.

Depth maps of small photographs, in a hull that a few masks may not cut alone, are good enough to
say where the object ends to within a few pixels; within these colours and edges decide. The masks
so cut give the next hull.

Depth maps lose what mirrors, and a mask that misses a part would cut it off for good. So parts that
were guessed, and end at stronger edges than they begin at, count as the object again, and what
nearly all masks show is put back into the others. Masks that agree are left as they are.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from robir.capture.capture import Capture, View
from robir.capture.images.opencv import cv2
from robir.capture.masks.guess import DISSENT, SIDE, Picture, recut, reduced, sharpened
from robir.geometry.config import GeometryConfig
from robir.geometry.hull import mask_distance, object_hull
from robir.geometry.lattice import Sampled
from robir.geometry.mesh.tracer import EmbreeTracer
from robir.geometry.rays import ReducedPhoto, reduce_view
from robir.geometry.selection import smooth_surface
from robir.geometry.stereo.fusion import entry_depth, stereo_surface
from robir.workers import side_by_side

Bytes = NDArray[np.uint8]
Layer = NDArray[np.float32]
Mask = NDArray[np.bool_]

# size of the photographs and of the lattice for these surfaces, as a share of the final ones
_COARSENESS = 0.64
_ROUNDS = 2  # surfaces and cuts, in turns
_AGREED = 0.055  # share of the masks outside of the hull of all below which they agree
# share of the masks that may miss a part of the object, and how deep within the hull of the others
# it is put back into them (pixels, where the longer side has `SIDE`)
_MISSING, _DEEP = 0.1, 1.0
_LEAST_PART = 0.01  # of the mask, from which a guessed part is looked at
_FIRMER = 1.2  # how much stronger the edge that it ends at is than the edge that it begins at
_BLUR = 1.5  # standard deviation of the blur before edges are measured (pixels)
_NEAR = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (5, 5))  # how far from a part its border is


def remasked(
    capture: Capture, config: GeometryConfig, progress: Callable[[float], None]
) -> Capture:
    """A capture, whose masks were guessed, with masks cut again, the held-out views' too."""
    side = round(_COARSENESS * config.stereo_side)
    pictures = reduced(capture.views, SIDE)

    def carved(by: Capture, dissent: float) -> tuple[list[ReducedPhoto], Sampled]:
        """Small photographs, and the hull of their masks that a share of them need not bound."""
        photos = [reduce_view(view, side) for view in by.train]
        return photos, object_hull(by, photos, config.hull_cells, dissent)

    photos, hull = carved(capture, DISSENT)
    guessed = _outlines(_tracer(hull), pictures)
    for number in range(_ROUNDS):
        if number:
            photos, hull = carved(capture, DISSENT)
        tracer = _tracer(stereo_surface(photos, hull, _COARSENESS))
        capture = replace(capture, views=cut_about(tracer, capture.views, pictures))
        progress((number + 1) / _ROUNDS)
    if _MISSING * len(photos) < 1:  # one of a few bounds a side of the object alone
        return capture
    parts = side_by_side(_parts, zip(capture.views, guessed, pictures, strict=True))
    more = replace(capture, views=_with_more(capture.views, parts))
    _, hull = carved(capture, 0.0)
    if _cut_off(more.views, _outlines(_tracer(hull), pictures)) < _AGREED:
        return capture
    _, hull = carved(more, _MISSING)
    common = [outline < -_DEEP for outline in _outlines(_tracer(hull), pictures)]
    return replace(capture, views=_with_more(capture.views, common))


def _tracer(surface: Sampled) -> EmbreeTracer:
    mesh = smooth_surface(surface)
    return EmbreeTracer(mesh.vertices, mesh.faces)


def _outlines(tracer: EmbreeTracer, pictures: Sequence[Picture]) -> list[Layer]:
    """Signed distances (H, W), pixels, from a surface's outline in each, negative inside."""
    shown = [np.isfinite(entry_depth(tracer, picture.camera)) for picture in pictures]
    return [mask_distance(one.astype(np.float32)) for one in shown]


def _held(view: View, outline: Layer) -> Mask:
    """A view's mask (h, w) at the size of a small picture."""
    return cv2.resize(view.mask, outline.shape[::-1], interpolation=cv2.INTER_AREA) > 127


def _cut_off(views: Sequence[View], outlines: Sequence[Layer]) -> float:
    """Share of the masks, in the mean, that lies outside of the hull of all, by its outlines."""
    shares = []
    for view, outline in zip(views, outlines, strict=True):
        held = _held(view, outline)
        shares.append((held & (outline >= 0)).sum() / max(held.sum(), 1))
    return float(np.mean(shares))


def _parts(item: tuple[View, Layer, Picture]) -> Mask:
    """Pixels (h, w) of parts beside a view's mask, which a guess expects, that end at firmer edges.

    By the signed distance (h, w) from the guessed outline, in a small picture.
    """
    view, guessed, picture = item
    held = _held(view, guessed)
    beside = (guessed < 0) & ~held
    beside = cv2.morphologyEx(beside.astype(np.uint8), cv2.MORPH_OPEN, _NEAR) == 1
    by_mask, by_rest = (
        cv2.dilate(own.astype(np.uint8), _NEAR) == 1 for own in (held, ~held & (guessed >= 0))
    )
    edges = _edges(picture.lab)
    _, parts, facts, _ = cv2.connectedComponentsWithStats(beside.astype(np.uint8), connectivity=8)
    found = np.zeros_like(held)
    for number in np.flatnonzero(facts[:, cv2.CC_STAT_AREA] >= _LEAST_PART * held.sum()):
        part = beside & (parts == number)
        begins, ends = edges[part & by_mask], edges[part & by_rest]
        if len(begins) and len(ends) and ends.mean() > _FIRMER * begins.mean():
            found |= part
    return found


def _edges(lab: Bytes) -> Layer:
    """Length (h, w) of the gradient of a picture's colours, CIE L*a*b* codes."""
    smooth = cv2.GaussianBlur(lab.astype(np.float32), (0, 0), _BLUR)
    slopes = [cv2.Scharr(smooth, -1, *axis) for axis in ((1, 0), (0, 1))]
    return np.sqrt(sum((slope**2).sum(axis=2) for slope in slopes)) / 32


def _with_more(views: Sequence[View], more: Sequence[Mask]) -> tuple[View, ...]:
    """Views whose masks hold more, which is said at a smaller size (h, w)."""

    def filled(view: View, own: Mask) -> View:
        size = view.mask.shape[::-1]
        large = cv2.resize(own.astype(np.float32), size, interpolation=cv2.INTER_LINEAR) > 0.5
        return replace(view, mask=np.where(large, np.uint8(255), view.mask))

    return tuple(filled(*pair) for pair in zip(views, more, strict=True))


def cut_about(
    tracer: EmbreeTracer, views: Sequence[View], pictures: Sequence[Picture] | None = None
) -> tuple[View, ...]:
    """Views with masks that end where colours and edges say so, near a surface's outline."""
    pictures = pictures or reduced(views, SIDE)
    cut = zip(views, recut(pictures, _outlines(tracer, pictures)), strict=True)
    return tuple(_with_mask(*pair) for pair in cut)


def _with_mask(view: View, belief: Layer) -> View:
    """A view with the mask of a belief, or as it was where that leaves nothing."""
    mask = sharpened(view.image_display, belief)
    return replace(view, mask=mask) if mask.any() else view
