# SPDX-License-Identifier: Apache-2.0
"""What stands before the object in some photographs and belongs to none of it: a hand, a stand.

Photographs that see the same points of the mesh should agree on them, up to one exposure each and
what gloss changes. Where a photograph shows, over a whole patch, what is far from the median of
all that see the same points, in units of how these differ among each other, something is in
front. What lies within a pixel counts as seen: no mesh and no camera is better than that. A
highlight differs as well, but it only adds light, about as much to every channel; that much is
taken off first, so of a white thing before a dark object only the rest is found. And gloss changes
little from one direction to the next: what a photograph from nearly the same one shows of the same
point as well belongs to the object. A thing that covers the same place in such photographs too, as
a stand close to the object does, is missed for it.

Batch letters: N points, V photographs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.ndimage import (
    binary_dilation,
    binary_fill_holes,
    binary_opening,
    binary_propagation,
    gaussian_filter,
    label,
    maximum_filter,
    minimum_filter,
)

from robir.capture.capture import View
from robir.capture.images.loading import resize_view
from robir.geometry.mesh.tracer import EmbreeTracer
from robir.geometry.mesh.triangles import Mesh
from robir.maths.tone_curve import linear_from_srgb, srgb_from_linear

Array = NDArray[np.float64]


_SIDE = 160  # longer side at which photographs are compared (pixels)
_POINTS = 30_000  # of the surface, that are compared
_LEAST_VIEWS = 8  # photographs that see a point, from which their median says what it looks like
_LEAST_COSINE = 0.35  # to the normal, from which a photograph is believed
_DARK = 0.03  # added to codes in [0, 1] before their log, so that noise in the dark is none there
_NOISE = 0.04  # least spread of that log
_UNLIKE = 5.0  # spreads from the median that are something else
_ASKED = 3  # photographs that see a point which are asked about it
_AMONG = 10  # of so many from the nearest directions
_ABOUT = 30.0  # angle from a photograph's direction up to which these are near (degrees)
_LIKE = 0.5  # of a photograph's distance from the median: one as near as that shows the same
_SHARE = 0.5  # of the points about a place that must be something else
# of a photograph's points; above it this is no thing in front but another light or a wrong
# camera, or one so large that the photograph's exposure is told by it
_MOST = 0.5
_BLUR = 1.5  # width about such a place (pixels)
_THIN = 0.02  # points a pixel below which a place cannot be told
_HIDDEN = 4  # distance within which that goes with a patch beside it (pixels)
# of what a photograph shows of the object; smaller patches are gloss or an error of the mesh
_LEAST_AREA = 0.008
_GROWN = 3  # by which a patch grows: its rim is mixed with the object (pixels)
_LIFT = 1e-3  # distance above the surface at which rays begin (unit frame)


@dataclass(frozen=True, slots=True, kw_only=True)
class Cleared:
    """Photographs without what stands in front.

    Attributes:
        views: All, with masks that leave it out.
        pixels: How many pixels each lost, by name; those that lost any.
        share: Of all the object's pixels in these photographs.
    """

    views: tuple[View, ...]
    pixels: dict[str, int]
    share: float

    def notes(self) -> tuple[str, ...]:
        """A sentence for the user, where there is anything to tell."""
        if not self.pixels:
            return ()
        names = sorted(self.pixels, key=self.pixels.__getitem__, reverse=True)
        more = "" if len(names) <= 5 else ", ..."
        return (
            f"Something stands before the object in {len(names)} of {len(self.views)} photographs "
            f"({', '.join(names[:5])}{more}): {sum(self.pixels.values())} pixels, {self.share:.1%} "
            "of the object there, differ from what the other photographs show of the same places; "
            "they are left out of light and texture.",
        )


def cleared(mesh: Mesh, views: Sequence[View]) -> Cleared:
    """Leave out of the photographs' masks what other photographs contradict.

    Args:
        mesh: Of the object, unit frame.
        views: With the outline of the mesh as mask.
    """
    position, normal = _points(mesh, _POINTS)
    tracer = EmbreeTracer(mesh.vertices, mesh.faces)
    small = [resize_view(view, _SIDE) for view in views]
    code = np.full((len(position), len(views), 3), np.nan, np.float32)
    around = code.copy(), code.copy()
    places = np.zeros((len(position), len(views), 2), np.int16)
    for number, view in enumerate(small):
        shown, pixel = _seen(tracer, position, normal, view)
        x, y = pixel.T
        picture = view.image_display / 255
        code[shown, number] = picture[y, x]
        for part, bound in zip(around, (minimum_filter, maximum_filter), strict=True):
            part[shown, number] = bound(picture, size=(3, 3, 1))[y, x]
        places[shown, number] = pixel
    far = _unlike(code, around, _neighbours(views))
    out, lost, total = [], {}, 0
    for number, (view, little) in enumerate(zip(views, small, strict=True)):
        patch = _patch(places[:, number], far[:, number], little)
        height, width = view.mask.shape
        rows = np.arange(height) * patch.shape[0] // height
        columns = np.arange(width) * patch.shape[1] // width
        large = patch[np.ix_(rows, columns)]
        gone = int((large & (view.mask > 127)).sum())
        if gone:
            lost[view.name] = gone
            total += int((view.mask > 127).sum())
            view = replace(view, mask=np.where(large, 0, view.mask).astype(np.uint8))
        out.append(view)
    return Cleared(views=tuple(out), pixels=lost, share=sum(lost.values()) / max(total, 1))


def _points(mesh: Mesh, count: int) -> tuple[Array, Array]:
    """So many points (N, 3) spread over a mesh by area, and the normals (N, 3) of their faces."""
    rng = np.random.default_rng(0)
    a, b, c = (mesh.vertices[mesh.faces[:, k]].astype(np.float64) for k in range(3))
    doubled = np.cross(b - a, c - a)
    area = np.linalg.norm(doubled, axis=1)
    face = rng.choice(len(area), count, p=area / area.sum())
    root, share = np.sqrt(rng.random((count, 1))), rng.random((count, 1))
    a, b, c = a[face], b[face], c[face]
    position = (1 - root) * a + root * (1 - share) * b + root * share * c
    return position, doubled[face] / area[face, None]


def _seen(
    tracer: EmbreeTracer, position: Array, normal: Array, view: View
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Numbers of the points that a photograph shows, and their pixels (x, y)."""
    towards = view.camera.position - position
    towards /= np.linalg.norm(towards, axis=1, keepdims=True)
    shown = np.flatnonzero((towards * normal).sum(1) > _LEAST_COSINE)
    pixels, depth = view.camera.project(position[shown])
    inside = view.camera.in_picture(pixels, depth)
    shown, pixel = shown[inside], np.floor(pixels[inside]).astype(np.int64)
    whole = view.mask[pixel[:, 1], pixel[:, 0]] == 255
    shown, pixel = shown[whole], pixel[whole]
    start = (position[shown] + _LIFT * normal[shown]).astype(np.float32)
    free = ~tracer.is_blocked(start, towards[shown].astype(np.float32))
    return shown[free], pixel[free]


def _neighbours(views: Sequence[View]) -> list[list[int]]:
    """Of each photograph those from nearly the same direction, the nearest first."""
    place = np.array([view.camera.position for view in views])
    towards = place / np.linalg.norm(place, axis=1, keepdims=True)
    cosine = towards @ towards.T
    np.fill_diagonal(cosine, -1.0)
    near = cosine > np.cos(np.radians(_ABOUT))
    order = np.argsort(-cosine, axis=1, kind="stable")[:, :_AMONG]
    return [[other for other in row if near[one, other]] for one, row in enumerate(order.tolist())]


def _unlike(
    code: NDArray[np.float32],
    around: tuple[NDArray[np.float32], NDArray[np.float32]],
    neighbours: Sequence[Sequence[int]],
) -> NDArray[np.float32]:
    """How far (N, V), in spreads, a photograph is from the median of a point; NaN where unknown.

    Args:
        code: (N, V, 3) in [0, 1], NaN where a photograph does not show a point.
        around: The lowest and the highest code, (N, V, 3) each, within a pixel.
        neighbours: Of each photograph.
    """
    far = np.full(code.shape[:2], np.nan, np.float32)
    many = np.isfinite(code[..., 0]).sum(1) >= _LEAST_VIEWS
    if not many.any():
        return far
    log = np.log(code[many] + _DARK)
    gain = np.zeros((1, *log.shape[1:]), np.float32)
    for _ in range(2):  # exposures by medians, and medians without exposures
        median = np.nanmedian(log - gain, axis=1, keepdims=True)
        for number in np.flatnonzero(np.isfinite(log[..., 0]).any(axis=0)):
            gain[0, number] = np.nanmedian((log - median)[:, number], axis=0)
    log -= gain
    median = np.nanmedian(log, axis=1, keepdims=True)
    spread = 1.4826 * np.nanmedian(np.abs(log - median), axis=1, keepdims=True)
    spread = np.hypot(spread, _NOISE)
    low, high = (np.log(part[many] + _DARK) - gain for part in around)
    # the mirror image of a light adds about as much to every channel, before the tone curve
    added = (_linear(low, _DARK) - _linear(median, _DARK)).min(axis=2, keepdims=True).clip(0)
    least, most = (_encoded((_linear(part, _DARK) - added).clip(0), _DARK) for part in (low, high))
    result = _apart(median, least, most, spread)
    for view, others in enumerate(neighbours):
        odd = np.flatnonzero(result[:, view] > _UNLIKE / 2)
        own = low[odd, view], high[odd, view], spread[odd, 0]
        beside = _shown_beside(log[odd], own, others, _ASKED)
        shown = beside < _LIKE * _apart(median[odd, 0], *own)
        result[odd[shown], view] = 0.0
    far[many] = result
    return far


def _apart(
    log: NDArray[np.float32],
    low: NDArray[np.float32],
    high: NDArray[np.float32],
    spread: NDArray[np.float32],
) -> NDArray[np.float32]:
    """How far (...) logarithms (..., 3) lie outside of bounds, in spreads, the worst channel."""
    return (np.maximum(low - log, log - high).clip(0) / spread).max(axis=-1)


def _shown_beside(
    log: NDArray[np.float32],
    own: tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]],
    others: Sequence[int],
    most: int,
) -> NDArray[np.float32]:
    """Distance (N,), in spreads, to the likest of those few of other photographs that see a point.

    Args:
        log: (N, V, 3), NaN where a photograph does not show a point.
        own: The photograph's lowest and highest within a pixel, and the spreads, (N, 3) each.
        others: Numbers of the other photographs, those to be asked first in front.
        most: Those of them that are asked about a point.
    """
    least, asked = np.full(len(log), np.inf, np.float32), np.zeros(len(log), int)
    for other in others:
        sees = np.isfinite(log[:, other, 0]) & (asked < most)
        least[sees] = np.minimum(least, _apart(log[:, other], *own))[sees]
        asked += sees
    return least


def _linear(log: NDArray[np.float32], dark: float) -> NDArray[np.float32]:
    """Light that the logarithms of codes stand for, by the sRGB curve."""
    return linear_from_srgb(torch.from_numpy((np.exp(log) - dark).clip(0))).numpy()


def _encoded(light: NDArray[np.float32], dark: float) -> NDArray[np.float32]:
    """Logarithms of the codes that light has by the sRGB curve; undoes `_linear`."""
    return np.log(srgb_from_linear(torch.from_numpy(light)).numpy() + dark)


def _patch(place: NDArray[np.int16], far: NDArray[np.float32], view: View) -> NDArray[np.bool_]:
    """Pixels of a small photograph that something in front covers."""
    shape = view.mask.shape
    known = np.isfinite(far)

    def density(chosen: NDArray[np.bool_]) -> Array:
        row, column = place[chosen, 1].astype(np.int64), place[chosen, 0].astype(np.int64)
        count = np.bincount(row * shape[1] + column, minlength=shape[0] * shape[1])
        return gaussian_filter(count.reshape(shape).astype(np.float64), _BLUR)

    odd = known & (far > _UNLIKE)
    if not odd.any() or odd.sum() > _MOST * known.sum():
        return np.zeros(shape, bool)
    inside = view.mask > 127
    all_known = density(known)
    least = _SHARE * all_known
    core = binary_opening((density(odd) > least) & inside, np.ones((3, 3)))
    parts, number = label(core)
    area = np.bincount(parts.ravel(), minlength=number + 1)
    large = area >= _LEAST_AREA * inside.sum()
    large[0] = False
    core = large[parts]
    if not core.any():
        return core
    doubtful = (density(known & (far > _UNLIKE / 2)) > least) & inside
    found = binary_propagation(core, mask=binary_opening(doubtful, np.ones((3, 3))) | core)
    about = binary_dilation(found, iterations=_HIDDEN) & (all_known < _THIN)
    return binary_fill_holes(binary_dilation(found | about, iterations=_GROWN))
