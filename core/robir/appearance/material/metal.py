# SPDX-License-Identifier: Apache-2.0
"""Which samples are metal, and the base colour and roughness of each metal part.

Polished metal shows its surroundings, displaced by every error of the mesh, so one sample's views
say little about its base colour. All views of a connected part together do: the median over them
of what is seen over what a white metal would show.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from torch import Tensor

from robir.appearance.light.problem import Problem
from robir.appearance.light.solver import Light
from robir.appearance.material.highlights import LEVELS
from robir.appearance.material.observed import dense, looked_at
from robir.appearance.material.reflections import TILTS, Reflections, ViewRays
from robir.appearance.material.segments import pieces

Floats = NDArray[np.float32]

METAL_ERROR = 0.03
"""Display error that a dielectric must leave before metal is thought of; those under a right mesh
leave 0.01 to 0.02."""

METAL_TOLERANCE = 20.0
"""How much worse than the dielectric a metal may fit, as a share per unit of display error beyond
METAL_ERROR: a mirror image is misplaced by the mesh's errors, but no dielectric changes so much."""

CERTAIN = 0.8
"""Error of a metal against the dielectric's, the same tolerance added, at which it explains a
sample better: each sample's normal may be tilted and its base colour is free, and so much is won by
that alone."""

TILTS_WIN = 1.25
"""Share by which a tilt of normals may lower the error of a metal; for a whole neighbourhood it is
0.1 to 0.25 on rendered metal and paint."""

METAL_LEVELS = LEVELS[:5]
"""Roughnesses at which metal is tried: a rougher one looks like a dielectric of another shade."""

METAL_NEIGHBOURS = 16
"""Samples that judge together whether they are metal."""

METAL_GAP = 2.0
"""Gap, in spacings of the samples, across which metal samples belong to one part."""

METAL_PRIOR = 30
"""Samples that all metal of the scene counts as in the base colour of one part."""

METAL_SPREAD = 0.25
"""How far base colours of metals differ within a scene, as logarithms. Of samples that metal does
not explain better the reading may be off by a factor of e: where there are many, a part is taken to
be of what the others are."""

DARKEST_METAL = 0.55
"""Brightest channel that every metal reaches at least: titanium, iron and chromium do."""

BRIGHT_METAL = 0.5
"""Brightest channel that metal must have at least where it explains a sample better: a tenth is
left to what the light is misjudged. No metal is dark, while a dark metal explains glossy dark paint
well."""

DARKEST_READING = 0.4
"""Brightest channel below which a part is no metal, whatever else explains its views badly: a
wrong mesh does, and is no brighter than paint."""

CERTAIN_SHARE = 0.9
"""Share of a part of METAL_PRIOR samples or more that metal must explain better to be metal however
dim it reads: a light that is judged too strong dims all readings."""

DIM_ERROR = 0.05
"""Mean display error that such a dim part may leave as metal. On a torn mesh metal explains most of
a stone better than paint, and both explain it badly: it left .065, the gold of bottles .036."""

LEAST_PART, LEAST_SHARE = 8, 1 / 3
"""Samples that metal must explain better, in number and as a share of a part. Where it is fewer,
the mesh is too wrong to tell, and what it reflected would be worse than paint."""

OTHER_HUE = 0.7
"""Difference in log hue from all metal of the scene from which a part of less than METAL_PRIOR
samples is paint: bits of one metal lie near each other."""

LIKELY_METAL = 0.6
"""Base colour towards which a part without any evidence tends."""


@dataclass(frozen=True, slots=True)
class MetalParts:
    """Connected metal parts.

    Attributes:
        part: (U,) part of every sample, -1 where it is no metal after all.
        base: (P, 3) base colour, linear Rec.709.
        roughness: (P,) perceptual.
    """

    part: NDArray[np.int64]
    base: Floats
    roughness: Floats


def neighbourhoods(points: Floats) -> NDArray[np.int64]:
    """Samples (U, N) that judge together with each, itself among them.

    Args:
        points: (U, D) positions, with scaled normals and colours so that one part judges together.
    """
    count = min(METAL_NEIGHBOURS, len(points))
    return cKDTree(points).query(points, k=count)[1].reshape(len(points), count)


def metal_errors(
    problem: Problem,
    light: Light,
    rows: NDArray[np.int64],
    dielectric: Floats,
    around: NDArray[np.int64],
) -> tuple[Floats, Floats]:
    """Mean display error of samples as metal, each with its own base colour and tilt of its normal.

    What metal shows moves by twice the normal's error. Under the mesh's normals a rough metal wins
    on every part, for it shows the least of what is misplaced. And a dark metal explains glossy
    dark paint, and whatever a wrong mesh makes of paint, better than paint does: so the base colour
    is tried as it fits best, and no darker than that of any metal.

    Args:
        problem: Scene under a tone curve.
        light: Its light.
        rows: (U,) samples.
        dielectric: (U, L) mean display error over each one's views at every roughness.
        around: (U, N) from `neighbourhoods`.

    Returns:
        (U, METAL_LEVELS) each, of any base colour and of bright ones; infinite where no
        neighbourhood asks.
    """
    errors = np.full((2, len(rows), len(METAL_LEVELS)), np.inf, np.float32)
    paint = _together(dielectric, around)
    asking = paint > METAL_ERROR
    # as the mesh has it first: where metal is far from any tilt's help, six more are not tried
    for tilts in (TILTS[:1], TILTS[1:]):
        asked = np.unique(around[asking])
        if len(asked):
            tried = _least_errors(problem, light, rows[asked], tilts)
            errors[:, asked] = np.minimum(errors[:, asked], tried)
        asking &= _together(errors[0], around) < TILTS_WIN * _allowed(paint, 1.0)
    return errors[0], errors[1]


def _least_errors(
    problem: Problem, light: Light, rows: NDArray[np.int64], tilts: tuple[tuple[float, float], ...]
) -> Floats:
    """Errors (2, U, METAL_LEVELS) of samples as any and as bright metal under the best tilt."""
    reflections, rays, seen, valid = looked_at(problem, light, rows)
    sample, shape = torch.from_numpy(rays.sample), (valid.shape[0], valid.shape[1])
    best = torch.full((2, len(rows), len(METAL_LEVELS)), float("inf"))
    tilted = [reflections.tilted(rays, tilt) for tilt in tilts]
    for index, level in enumerate(METAL_LEVELS):
        for tilt, mirrored in zip(tilts, tilted, strict=True):
            sky = reflections.from_sky(mirrored, level)
            white = (sky + reflections.from_suns(rays, level, tilt))[:, 1]
            ratio = dense(seen.linear / white.clamp(min=1e-5), rays, shape)
            base = ratio.masked_fill(~valid[..., None], float("nan")).nanmedian(1).values
            base = base.clamp(1e-3, 1)
            bright = base * (BRIGHT_METAL / base.amax(1, keepdim=True)).clamp(min=1)
            for kind, tried in enumerate((base, bright)):
                error = seen.error(tried[sample] * white)
                total = torch.zeros(len(rows)).index_add_(0, sample, error)
                best[kind, :, index] = torch.minimum(best[kind, :, index], total)
    return (best / valid.sum(1).clamp(min=1)[:, None]).numpy()


def _together(errors: Floats, around: NDArray[np.int64]) -> Floats:
    """Least error (U,) of each neighbourhood at one roughness, of errors (U, L)."""
    return errors[around].mean(1).min(1)


def _allowed(paint: Floats, share: float) -> Floats:
    """Error (U,) that metal may leave where paint leaves `paint`, beyond METAL_ERROR."""
    return paint * (share + METAL_TOLERANCE * (paint - METAL_ERROR))


def metal_samples(
    dielectric: Floats, metal: Floats, around: NDArray[np.int64]
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Samples whose neighbourhood may be metal, and those where metal explains it better.

    Args:
        dielectric: (U, L) mean display error over each sample's views at every roughness.
        metal: (U, M) the same as metal, infinite where it is not known.
        around: (U, N) from `neighbourhoods`.

    Returns:
        (U,) bool each, the second within the first.
    """
    paint, best = _together(dielectric, around), _together(metal, around)
    likely, certain = (
        ((paint > METAL_ERROR) & (best < _allowed(paint, share)))[around].mean(1) > 0.5
        for share in (1.0, CERTAIN)
    )
    known = np.isfinite(metal[:, 0])
    return likely & known, likely & certain & known


def metal_parts(
    samples: tuple[NDArray[np.bool_], NDArray[np.bool_]],
    place: tuple[Floats, Floats, float],
    observed: tuple[Reflections, ViewRays, Tensor],
    errors: Floats,
) -> MetalParts:
    """Gather metal samples into parts and read what each is made of.

    A part reaches as far as its samples may be metal and are of one hue, but there must be some
    that metal explains better than paint, and these must be bright enough, or nearly all there is
    and explained well: views also differ where the mesh is wrong, and where paint is glossy. The
    fewer they are, the more its base colour is taken to be that of the other parts.

    Args:
        samples: (U,) bool each, from `metal_samples`, the second those that bright metal explains
            better too.
        place: Positions (U, 3), unit frame, log hues (U, 3) about them, and their spacing.
        observed: What the samples reflect, their rays (M), and the radiance (M, 3) that is seen.
        errors: (U, METAL_LEVELS) mean display error of each sample as metal.

    Returns:
        The parts.
    """
    likely, certain = samples
    rows = np.flatnonzero(likely)
    position, hue, spacing = place
    piece, part = np.full(len(likely), -1), np.full(len(likely), -1)
    if len(rows):
        piece[rows] = pieces(position[rows], hue[rows], METAL_GAP * spacing, LEAST_PART)
    reflections, rays, linear = observed
    bases, roughness, sizes = [], [], []
    readings: dict[float, Floats] = {}
    for index in range(piece.max() + 1):
        whole = piece == index
        inside = certain & whole
        size, number = whole.sum(), inside.sum()
        if number < max(LEAST_PART, LEAST_SHARE * size):
            continue
        left = errors[inside].mean(0)
        is_certain = number >= max(METAL_PRIOR, CERTAIN_SHARE * size) and left.min() < DIM_ERROR
        # On a wrong mesh the roughest wins, and under it a sun is mirrored in every view: what is
        # seen reads dark, but not as a sharper metal.
        for level in reversed(METAL_LEVELS[: int(left.argmin()) + 1]):
            if level not in readings:
                white = reflections.radiance(rays, level)[:, 1].clamp(min=1e-5)
                readings[level] = (linear / white).numpy()
            clear, base = (
                np.median(readings[level][some[rays.sample]], axis=0) for some in (inside, whole)
            )
            if is_certain or clear.max() >= DARKEST_READING:
                part[whole] = len(bases)
                bases.append(base)
                roughness.append(level)
                doubt = (1 - number / size) / METAL_SPREAD
                sizes.append(number / (1 + doubt**2 * number / METAL_PRIOR))
                break
    if not bases:
        return MetalParts(part, np.zeros((0, 3), np.float32), np.zeros(0, np.float32))
    log, count = np.log(np.stack(bases).clip(0.05, 1.0)), np.array(sizes)[:, None]
    kept = _alike(log, count)
    part = np.where(part >= 0, np.where(kept, np.cumsum(kept) - 1, -1)[part], -1)
    if not kept.any():
        return MetalParts(part, np.zeros((0, 3), np.float32), np.zeros(0, np.float32))
    log, count = log[kept], count[kept]
    everywhere = 0.5 * ((count * log).sum(0) / count.sum() + np.log(LIKELY_METAL))
    weight = count / (count + METAL_PRIOR)
    base = np.exp(weight * log + (1 - weight) * everywhere)
    base *= np.maximum(1.0, DARKEST_METAL / base.max(axis=1, keepdims=True))
    return MetalParts(part, base.astype(np.float32), np.array(roughness, np.float32)[kept])


def _alike(log: Floats, count: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Which (P,) of parts of these log colours (P, 3) and sizes (P, 1) are no odd bits."""
    hue = log - log.mean(1, keepdims=True)
    apart = np.linalg.norm(hue - (count * hue).sum(0) / count.sum(), axis=1)
    return (apart < OTHER_HUE) | (count[:, 0] >= METAL_PRIOR)
