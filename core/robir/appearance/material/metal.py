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
from robir.appearance.material.config import MaterialConfig, MetalConfig
from robir.appearance.material.observed import dense, looked_at
from robir.appearance.material.reflections import Reflections, ViewRays, tilts_of
from robir.appearance.material.segments import pieces
from robir.appearance.material.trial import Trial

Floats = NDArray[np.float32]


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


def likely_metal(
    solved: tuple[Problem, Light],
    rows: NDArray[np.int64],
    alike: tuple[Floats, Floats],
    trial: Trial,
    dielectric: Floats,
) -> MetalParts:
    """Parts of samples (U,) that may be metal.

    Args:
        solved: Scene under a tone curve, and its light.
        rows: The samples.
        alike: (U, 9) points by which they are judged together, and (U, 3) log hues.
        trial: The samples in all views.
        dielectric: (U, L) mean display error over each one's views at every roughness.
    """
    (problem, light), (points, hue) = solved, alike
    surfels, config = problem.scene.transport.surfels, problem.scene.config.material
    around = neighbourhoods(points, config.metal.neighbours)
    errors, bright = metal_errors(problem, light, rows, dielectric, around)
    likely, certain = metal_samples(dielectric, errors, around, config.metal)
    certain &= metal_samples(dielectric, bright, around, config.metal)[1]
    spacing = surfels.spacing * float(np.sqrt(len(surfels) / len(rows)))
    place = surfels.position[rows], hue[around].mean(1), spacing
    observed = trial.reflections, trial.rays, trial.seen.linear
    return metal_parts((likely, certain), place, observed, errors, config)


def neighbourhoods(points: Floats, most: int) -> NDArray[np.int64]:
    """Samples (U, N) that judge together with each, itself among them.

    Args:
        points: (U, D) positions, with scaled normals and colours so that one part judges together.
        most: N, where there are as many.
    """
    count = min(most, len(points))
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
        (U, L) each, at all `metal_levels`, of any base colour and of bright ones; infinite where no
        neighbourhood asks.
    """
    config = problem.scene.config.material
    metal, tilts = config.metal, tilts_of(config.reflections)
    errors = np.full((2, len(rows), len(config.metal_levels)), np.inf, np.float32)
    paint = _together(dielectric, around)
    asking = paint > metal.paint_error
    # as the mesh has it first: where metal is far from any tilt's help, six more are not tried
    for some in (tilts[:1], tilts[1:]):
        asked = np.unique(around[asking])
        if len(asked):
            tried = _least_errors(problem, light, rows[asked], some)
            errors[:, asked] = np.minimum(errors[:, asked], tried)
        asking &= _together(errors[0], around) < metal.tilt_gain * _allowed(paint, 1.0, metal)
    return errors[0], errors[1]


def _least_errors(
    problem: Problem,
    light: Light,
    rows: NDArray[np.int64],
    tilts: tuple[tuple[float, float], ...],
) -> Floats:
    """Errors (2, U, L) of samples as any and as bright metal under the best tilt."""
    config = problem.scene.config.material
    reflections, rays, seen, valid = looked_at(problem, light, rows)
    sample, shape = torch.from_numpy(rays.sample), (valid.shape[0], valid.shape[1])
    best = torch.full((2, len(rows), len(config.metal_levels)), float("inf"))
    tilted = [reflections.tilted(rays, tilt) for tilt in tilts]
    for index, level in enumerate(config.metal_levels):
        for tilt, mirrored in zip(tilts, tilted, strict=True):
            sky = reflections.from_sky(mirrored, level)
            white = (sky + reflections.from_suns(rays, level, tilt))[:, 1]
            ratio = dense(seen.linear / white.clamp(min=1e-5), rays, shape)
            base = ratio.masked_fill(~valid[..., None], float("nan")).nanmedian(1).values
            base = base.clamp(1e-3, 1)
            bright = base * (config.metal.bright_metal / base.amax(1, keepdim=True)).clamp(min=1)
            for kind, tried in enumerate((base, bright)):
                error = seen.error(tried[sample] * white)
                total = torch.zeros(len(rows)).index_add_(0, sample, error)
                best[kind, :, index] = torch.minimum(best[kind, :, index], total)
    return (best / valid.sum(1).clamp(min=1)[:, None]).numpy()


def _together(errors: Floats, around: NDArray[np.int64]) -> Floats:
    """Least error (U,) of each neighbourhood at one roughness, of errors (U, L)."""
    return errors[around].mean(1).min(1)


def _allowed(paint: Floats, share: float, config: MetalConfig) -> Floats:
    """Error (U,) that metal may leave where paint leaves `paint`, beyond its usual one."""
    return paint * (share + config.tolerance * (paint - config.paint_error))


def metal_samples(
    dielectric: Floats, metal: Floats, around: NDArray[np.int64], config: MetalConfig
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Samples whose neighbourhood may be metal, and those where metal explains it better.

    Args:
        dielectric: (U, L) mean display error over each sample's views at every roughness.
        metal: (U, M) the same as metal, infinite where it is not known.
        around: (U, N) from `neighbourhoods`.
        config: How much worse metal may fit.

    Returns:
        (U,) bool each, the second within the first.
    """
    paint, best = _together(dielectric, around), _together(metal, around)
    is_odd = paint > config.paint_error
    likely, certain = (
        (is_odd & (best < _allowed(paint, share, config)))[around].mean(1) > 0.5
        for share in (1.0, config.certain_ratio)
    )
    known = np.isfinite(metal[:, 0])
    return likely & known, likely & certain & known


def metal_parts(
    samples: tuple[NDArray[np.bool_], NDArray[np.bool_]],
    place: tuple[Floats, Floats, float],
    observed: tuple[Reflections, ViewRays, Tensor],
    errors: Floats,
    config: MaterialConfig,
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
        errors: (U, L) mean display error of each sample as metal, at all `metal_levels`.
        config: What makes a part, and what metals there are.

    Returns:
        The parts.
    """
    likely, certain = samples
    metal = config.metal
    rows = np.flatnonzero(likely)
    position, hue, spacing = place
    piece, part = np.full(len(likely), -1), np.full(len(likely), -1)
    if len(rows):
        gap, fewest = metal.gap * spacing, metal.least_part
        piece[rows] = pieces(position[rows], hue[rows], gap, fewest, config.segments)
    reflections, rays, linear = observed
    bases, roughness, sizes = [], [], []
    readings: dict[float, Floats] = {}
    for index in range(piece.max() + 1):
        whole = piece == index
        inside = certain & whole
        size, number = whole.sum(), inside.sum()
        if number < max(metal.least_part, metal.least_share * size):
            continue
        left = errors[inside].mean(0)
        is_certain = number >= max(metal.prior, metal.certain_share * size)
        is_certain &= left.min() < metal.dim_error
        # On a wrong mesh the roughest wins, and under it a sun is mirrored in every view: what is
        # seen reads dark, but not as a sharper metal.
        for level in reversed(config.metal_levels[: int(left.argmin()) + 1]):
            if level not in readings:
                white = reflections.radiance(rays, level)[:, 1].clamp(min=1e-5)
                readings[level] = (linear / white).numpy()
            clear, base = (
                np.median(readings[level][some[rays.sample]], axis=0) for some in (inside, whole)
            )
            if is_certain or clear.max() >= metal.darkest_reading:
                part[whole] = len(bases)
                bases.append(base)
                roughness.append(level)
                doubt = (1 - number / size) / metal.spread
                sizes.append(number / (1 + doubt**2 * number / metal.prior))
                break
    if not bases:
        return MetalParts(part, np.zeros((0, 3), np.float32), np.zeros(0, np.float32))
    log, count = np.log(np.stack(bases).clip(0.05, 1.0)), np.array(sizes)[:, None]
    kept = _alike(log, count, metal)
    part = np.where(part >= 0, np.where(kept, np.cumsum(kept) - 1, -1)[part], -1)
    if not kept.any():
        return MetalParts(part, np.zeros((0, 3), np.float32), np.zeros(0, np.float32))
    log, count = log[kept], count[kept]
    everywhere = 0.5 * ((count * log).sum(0) / count.sum() + np.log(metal.likely_base))
    weight = count / (count + metal.prior)
    base = np.exp(weight * log + (1 - weight) * everywhere)
    base *= np.maximum(1.0, metal.darkest_metal / base.max(axis=1, keepdims=True))
    return MetalParts(part, base.astype(np.float32), np.array(roughness, np.float32)[kept])


def _alike(log: Floats, count: NDArray[np.int64], config: MetalConfig) -> NDArray[np.bool_]:
    """Which (P,) of parts of these log colours (P, 3) and sizes (P, 1) are no odd bits."""
    hue = log - log.mean(1, keepdims=True)
    apart = np.linalg.norm(hue - (count * hue).sum(0) / count.sum(), axis=1)
    return (apart < config.other_hue) | (count[:, 0] >= config.prior)
