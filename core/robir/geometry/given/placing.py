# SPDX-License-Identifier: Apache-2.0
"""Whether a mesh stands where the photographs show it, and if not, how it would.

The outline of the mesh is held against the masks at some pixels of a few photographs. What fits
better is looked for among turns, scales and shifts: the axes that programs swap, then turns of all
kinds, each with the mesh's bounding sphere on that of the masks; the best are followed downhill.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from robir.capture.bounds import MARGIN, enclosing_sphere
from robir.capture.capture import View
from robir.capture.images.loading import size_within
from robir.errors import CaptureError
from robir.geometry.mesh.tracer import EmbreeTracer
from robir.jobs.paths import replacing
from robir.maths.similarity import AS_IT_IS, Similarity
from robir.maths.vectors import farthest_points

Array = NDArray[np.float64]


_VIEWS = 12  # photographs that are looked at
_SCAN_SIDE = 14  # pixels along a photograph's longer side that are looked at to rank turns
COARSE_SIDE = 28  # the same to search
FINE_SIDE = 80  # the same to judge (pixels)
_PAD = 0.5  # of a photograph's sides: how far beyond its cut the mesh is looked for as well
_TURNS = 500  # turns of all kinds that are tried; 500 are about 25 degrees from each other
_FOLLOWED = 5  # of them, those that are followed downhill
_BALANCES = 2  # how often each is scaled and shifted to suit the masks where its size is not known
_FIRST_TURN = 0.15  # first step of a search downhill, about each axis (radians)
_FIRST_SCALE = 0.1  # the same of the size, its logarithm
_FIRST_SHIFT = 0.08  # the same along each axis (unit frame)
_EVALUATIONS = 250  # places that such a search looks at
# share, and first steps above, by which the last places of a search differ
_COARSE_TOLERANCE, _FINE_TOLERANCE = 2e-3, 3e-4
# share of outline and mask that both have from which a mesh stands nearly right, and what is off
# is followed from there
_NEARLY = 0.5
_LIKELY = 0.7  # share from which a place is looked at closely: a little less than is proposed
FITS = 0.9  # share from which it stands right; of its own masks a mesh of ours has 0.97
BETTER = 0.05  # by how much more of that another place has to have to be believed
_UNRELATED = 0.5  # below which a mesh shows something else
# share of the masks that a mesh within them may lack, or of it that may lie beyond them all
_MOST_APART = 0.8
# faces whose boxes a line through the bounding sphere meets, mean: 3 to 5 of a scan, hundreds of a
# disc of a thousand slivers. Each costs every ray, and what has more is no surface
_MOST_CROSSED = 2000
_PHOTOGRAPHS = 4  # in a row of the picture of a fit
_SIDE = 240  # longer side of each (pixels)


@dataclass(frozen=True, slots=True, kw_only=True)
class Agreement:
    """How an outline and the masks go together."""

    share: float  # of what either has, what both have, mean over the photographs, in [0, 1]
    missing: float  # share of the masks that the outline leaves free
    beyond: float  # share of the outline that lies outside the masks


class Outlines:
    """Masks of a few training views, unit frame, at some pixels along their longer side."""

    def __init__(self, views: Sequence[View], side: int) -> None:
        chosen = farthest_points(np.stack([view.camera.position for view in views]), _VIEWS)
        origins, directions, masks, owners = [], [], [], []
        for number, index in enumerate(chosen):
            view = views[index]
            places, mask = _looked_at(view, side, _PAD)
            origin, direction = view.camera.rays(places)
            origins.append(origin)
            directions.append(direction)
            masks.append(mask)
            owners.append(np.full(len(mask), number))
        self.origins, self.directions = np.concatenate(origins), np.concatenate(directions)
        self.mask, self._owner = np.concatenate(masks), np.concatenate(owners)
        self._eyes = np.stack([views[index].camera.position for index in chosen])
        self._count = len(chosen)

    def sphere(self) -> tuple[Array, float]:
        """Where the masks say that the object is: a centre (3,), and a radius that suits a ball.

        Other than a visual hull this is not led astray where all photographs are from one side.
        """
        eyes, middle, width = self._seen(self.mask)
        centre = _nearest(eyes, middle)
        away = np.linalg.norm(centre - eyes, axis=1)
        return centre, float(np.median(away * width)) * 2**0.5

    def balanced(self, tracer: EmbreeTracer, place: Similarity) -> Similarity:
        """A place scaled and shifted so that outlines are as wide as masks, and lie as these do."""
        met = is_met(tracer, place, (self.origins, self.directions))
        (eyes, there, width), (_, here, wide) = self._seen(self.mask), self._seen(met)
        shown = (width > 0) & (wide > 0)
        if shown.sum() < 2:
            return place
        was = _nearest(eyes[shown], here[shown])
        now = _nearest(eyes[shown], there[shown])
        grown = float(np.median(width[shown] / wide[shown]))
        shift = now + grown * (place.shift - was)
        return Similarity(turn=place.turn, scale=grown * place.scale, shift=shift)

    def _seen(self, pixels: NDArray[np.bool_]) -> tuple[Array, Array, Array]:
        """Of pixels (N,): eyes (V, 3), mean directions (V, 3), and the spread (V,) about them."""
        owners = self._owner[pixels]
        count = np.maximum(np.bincount(owners, minlength=self._count), 1)

        def mean(values: Array) -> Array:
            return np.bincount(owners, values, minlength=self._count) / count

        own = self.directions[pixels]
        middle = np.stack([mean(own[:, k]) for k in range(3)], axis=1)
        spread = np.sqrt(mean(((own - middle[owners]) ** 2).sum(axis=1)))
        return self._eyes, middle, spread

    def of(self, tracer: EmbreeTracer, place: Similarity) -> Agreement:
        """Agreement of the masks with a mesh that a similarity brings to its place."""
        shown = is_met(tracer, place, (self.origins, self.directions))
        both = np.bincount(self._owner, shown & self.mask)
        either = np.bincount(self._owner, shown | self.mask)
        masked, seen = np.bincount(self._owner, self.mask), np.bincount(self._owner, shown)
        shares = both / np.maximum(either, 1)
        return Agreement(
            share=float(shares.mean()),
            missing=float(1 - both.sum() / max(masked.sum(), 1)),
            beyond=float(1 - both.sum() / max(seen.sum(), 1)) if seen.sum() else 0.0,
        )


def covering(vertices: Array, faces: NDArray[np.int32]) -> EmbreeTracer:
    """Tracer of what a mesh covers: a ray that meets one of many equal faces meets them all.

    `CaptureError` if each ray would have to look at thousands of others. The mesh's bounding
    sphere is the unit sphere.
    """
    # faces of one place have one middle; where none have, nothing more is looked at
    middles = vertices[faces].sum(axis=1) @ np.array([1.0, np.pi, np.e])
    if len(np.unique(middles)) < len(faces):
        _, places = np.unique(vertices, axis=0, return_inverse=True)
        corners = np.sort(places.reshape(-1)[faces], axis=1)
        faces = faces[np.unique(corners, axis=0, return_index=True)[1]]
    # a line through a sphere meets a convex body in it by the ratio of their surfaces
    sides = np.ptp(vertices[faces], axis=1)
    crossed = 2 * (sides * np.roll(sides, 1, axis=1)).sum() / (4 * np.pi)
    if crossed > _MOST_CROSSED:
        raise CaptureError(
            f"the mesh is no surface: a line through it passes the boxes of {crossed:.0f} of its "
            f"{len(faces)} faces, of at most {_MOST_CROSSED}, for they lie across each other; "
            "export the surface of the object, without loose faces"
        )
    return EmbreeTracer(vertices.astype(np.float32), faces)


def is_met(tracer: EmbreeTracer, place: Similarity, rays: tuple[Array, Array]) -> NDArray[np.bool_]:
    """Whether rays, origins and directions (N, 3), meet a mesh that a similarity brings there."""
    origins, directions = rays
    origins = (origins - place.shift) @ place.turn / place.scale
    directions = directions @ place.turn
    return tracer.is_blocked(origins.astype(np.float32), directions.astype(np.float32))


def better_place(
    vertices: Array,
    tracer: EmbreeTracer,
    views: Sequence[View],
    here: Similarity | None,
) -> tuple[Similarity, Agreement]:
    """The similarity that brings a mesh where its outline fits the masks best, and how well.

    It mirrors only where nothing else fits. The mesh's bounding sphere is the unit sphere; `here`
    brings it to where it is, None where that tells nothing.
    """
    scan, coarse, fine = (Outlines(views, side) for side in (_SCAN_SIDE, COARSE_SIDE, FINE_SIDE))

    def finished(start: Similarity, least: float) -> tuple[Similarity, Agreement]:
        place, share = _downhill(start, tracer, coarse, _COARSE_TOLERANCE)
        if share > least:
            place, _ = _downhill(place, tracer, fine, _FINE_TOLERANCE)
        return place, fine.of(tracer, place)

    centre, radius = enclosing_sphere(vertices)
    found = here or AS_IT_IS
    best = fine.of(tracer, found)
    if here and best.share > _NEARLY:
        # what is off by a little is not searched for far away
        found, best = finished(found, _LIKELY)
    for handed in (1.0, -1.0):
        if best.share >= FITS:
            break
        tried = [
            Similarity(turn=turn, scale=scale, shift=-scale * turn @ centre)
            for turn in handed * _turns(_TURNS)
            for scale in [1 / (MARGIN * radius)]
        ]
        for _ in range(0 if here else _BALANCES):
            tried = [scan.balanced(tracer, place) for place in tried]
        shares = np.array([scan.of(tracer, place).share for place in tried])
        first = np.argsort(-shares)[:_FOLLOWED]
        followed = [_downhill(tried[k], tracer, scan, _COARSE_TOLERANCE) for k in first]
        start, share = max(followed, key=lambda pair: pair[1])
        if share <= best.share:  # finishing adds less than what is asked for
            continue
        place, agreement = finished(start, max(_LIKELY, best.share))
        if agreement.share > best.share + BETTER:
            found, best = place, agreement
    return found, best


def _downhill(
    start: Similarity, tracer: EmbreeTracer, outlines: Outlines, tolerance: float
) -> tuple[Similarity, float]:
    """The best place near another, and the share there (Nelder and Mead 1965)."""

    def moved(x: Array) -> Similarity:
        turn = Rotation.from_rotvec(x[:3]).as_matrix() @ start.turn
        return Similarity(
            turn=turn,
            scale=start.scale * float(np.exp(x[3])),
            # about the middle of the unit sphere, so that turn and shift hardly disturb each other
            shift=np.exp(x[3]) * Rotation.from_rotvec(x[:3]).apply(start.shift) + x[4:],
        )

    steps = np.diag([_FIRST_TURN] * 3 + [_FIRST_SCALE] + [_FIRST_SHIFT] * 3)
    steps *= tolerance / _COARSE_TOLERANCE  # what was followed before is near
    simplex = np.concatenate([np.zeros((1, 7)), steps])
    limits = {"maxfev": _EVALUATIONS, "xatol": tolerance, "fatol": tolerance}
    found = minimize(
        lambda x: -outlines.of(tracer, moved(x)).share,
        np.zeros(7),
        method="Nelder-Mead",
        options={"initial_simplex": simplex, **limits},
    )
    return moved(found.x), -float(found.fun)


def _nearest(origins: Array, directions: Array) -> Array:
    """The point (3,) nearest to lines (N, 3), by least squares."""
    along = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    across = np.eye(3) - along[:, :, None] * along[:, None, :]
    right = np.einsum("nij,nj->i", across, origins)
    return np.linalg.lstsq(across.sum(axis=0), right, rcond=None)[0]


def _looked_at(view: View, side: int, pad: float) -> tuple[Array, NDArray[np.bool_]]:
    """Centres (N, 2) of pixels in and about a photograph, and whether they show the object."""
    camera = view.camera
    height, width = view.mask.shape
    step = max(1, max(height, width) // side)
    rows, columns = (
        np.arange(-int(pad * n) // step * step + step // 2, n + int(pad * n), step)
        for n in (height, width)
    )
    row, column = (grid.ravel() for grid in np.meshgrid(rows, columns, indexing="ij"))
    inside = (row >= 0) & (row < height) & (column >= 0) & (column < width)
    mask = np.zeros(len(row), bool)
    mask[inside] = view.mask[row[inside], column[inside]] > 127
    places = np.stack([column + 0.5, row + 0.5], axis=1)
    known = inside | camera.in_photograph(places, np.ones(len(places)))
    return places[known], mask[known]


def _turns(others: int) -> Array:
    """Turns that are tried, (N, 3, 3): all that bring axes onto axes, and so many others."""
    axes = Rotation.create_group("O").as_matrix()
    return np.concatenate([axes, Rotation.random(others, random_state=0).as_matrix()])


def is_related(agreement: Agreement) -> bool:
    """Whether a mesh shows the object, or a part of it, or it and more, at the right place."""
    wrong = sorted((agreement.missing, agreement.beyond))
    is_part = wrong[0] <= 1 - FITS and wrong[1] < _MOST_APART
    return agreement.share >= _UNRELATED or is_part


def poor_fit(agreement: Agreement) -> tuple[str, ...]:
    """What is to be said of a mesh that stands right and yet is not what the masks show."""
    if agreement.share >= FITS:
        return ()
    parts = []
    if agreement.missing > 1 - FITS:
        parts.append(
            f"it lacks {agreement.missing:.0%} of what the masks show, of which nothing is made"
        )
    if agreement.beyond > 1 - FITS:
        parts.append(
            f"{agreement.beyond:.0%} of its outline lies beyond the masks; that part only shades"
        )
    return (f"The mesh fits the masks by {agreement.share:.0%} only: {' and '.join(parts)}.",)


def show_fit(
    tracer: EmbreeTracer, places: Sequence[Similarity], views: Sequence[View], picture: Path
) -> None:
    """Write photographs with the mesh over them, red, a row for each place, as a PNG."""
    positions = np.stack([view.camera.position for view in views])
    chosen = farthest_points(positions, _PHOTOGRAPHS)
    sheet = Image.new("RGB", (_SIDE * len(chosen), _SIDE * len(places)))
    for column, view in enumerate(views[k] for k in chosen):
        size = size_within((view.camera.width, view.camera.height), _SIDE)
        small = view.camera.resized(*size)
        photo = np.array(Image.fromarray(view.image_display).resize(size))
        rays = small.rays(small.pixel_centres())
        for row, place in enumerate(places):
            shown = is_met(tracer, place, rays).reshape(photo.shape[:2])
            over = photo.copy()
            over[shown] = over[shown] // 2 + np.array([127, 0, 0], np.uint8)
            sheet.paste(Image.fromarray(over), (_SIDE * column, _SIDE * row))
    with replacing(picture) as temporary:
        sheet.save(temporary, format="PNG")
