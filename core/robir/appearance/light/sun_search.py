# SPDX-License-Identifier: Apache-2.0
"""Suns of one scene under one tone curve: where they are, and how large."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from robir.appearance.config import AppearanceConfig
from robir.appearance.light.lobes import log_ratio
from robir.appearance.light.pair_loss import PairWeights
from robir.appearance.light.problem import PAIR_REACHES, Problem
from robir.appearance.light.solver import Light, fit, no_suns
from robir.appearance.light.sun import SEPARATION, SunCandidate, SunProblem, refine, scan
from robir.appearance.light.sunlight import Sunlight
from robir.appearance.photometry.statistics import Pairs, neighbour_pairs
from robir.workers import side_by_side

Floats = NDArray[np.float32]

# share by which a further sharp lobe must lower the differences across its own shadow
_LEAST_SHADOW_GAIN = 0.15
# what it may leave of them where it lowers no other difference
_PLAIN_SHADOW = 0.5
# share by which a sun must lower the neighbour loss; the first need not if its shadow shows
_LEAST_GAIN = 0.02
# gain in the scan, over `_LEAST_GAIN`, that a further sun must have to be tried. With all lights
# solved anew a second lamp gains up to three times as much.
_PROMISING = 0.25
# gain in the scan, over the best one's, that other candidates for the first sun must have
_SECOND_BEST = 0.1
_NUM_CANDIDATES = 3  # directions of the scan that may be tried at most
_SEARCH_REACH = 0.8  # radius of the first ring of the search, spacings of the scan
_SCAN_SAMPLES = 2000  # surface samples that the scan compares
_SHARPNESS = 2000.0  # of a sun before its own is searched: about 1.3 degrees across
_TRIED_SHARPNESS = (100.0, 400.0, 2000.0, 10000.0)  # of these the one is taken that fits best
# cosine between the normals of pairs by which a sun is found and polished: where shadows lie tells
# its place, while what changes with the orientation, paint or what a metal mirrors, passes for
# shading
_ALIKE_COSINE = 0.8
# difference at which pairs hardly count when a sun is polished: more than a shadow in the wrong
# place makes, less than there is between the fields of a board (log albedo)
_ALIKE_ALBEDO = 1.0
# pairs per sample and distance then, by all samples that two views see: by those of the solve alone
# they hang on chance
_POLISH_PARTNERS = 4
# cosine between the normals of those pairs. Nearly all of them lie on one level surface, where
# nothing but a shadow changes with the sun's direction.
_LEVEL_COSINE = 0.95
_POLISH_REACH = 0.03  # radius of the first ring of the search then (radians)


def find_suns(problem: Problem, config: AppearanceConfig, seed: int) -> Light:
    """Add sharp lobes one at a time while each explains shadows that nothing else does.

    All is compared by pairs that face alike; strengths are from short solves.
    """
    scene = problem.scene
    normal = scene.transport.surfels.normal[scene.rows]
    pairs = scene.pairs.facing_alike(normal, _ALIKE_COSINE)
    problem = replace(problem, scene=replace(scene, pairs=pairs))
    axes, sharpness = no_suns()
    trial = config.iterations // 3
    light = fit(problem, axes, sharpness, trial)
    losses = [light.loss]
    for index in range(config.num_sharp_lobes):
        refined = _searched(problem, light, config, index, seed)
        addition = _best_addition(problem, light, refined, trial)
        if addition is None:
            break
        left, best = addition
        is_known, is_seen = _is_told(problem, light), _shows(left)
        gains = 1 - best.loss / light.loss > _LEAST_GAIN
        # The first sun may be known from its shadow, however small, or from its shading alone, as
        # on a lone convex object; a further one needs both.
        if not (is_known or (is_seen or gains if index == 0 else is_seen and gains)):
            break
        light = best
        losses.append(light.loss)
    return replace(light, history=tuple(losses))


def _is_told(problem: Problem, light: Light) -> bool:
    """Whether the sun to be added to a light is the one that the user knows."""
    return problem.scene.sun is not None and not len(light.axes)


def _searched(
    problem: Problem, light: Light, config: AppearanceConfig, index: int, seed: int
) -> list[SunCandidate]:
    """Where the next sun may be: about the user's direction, or all that a scan finds."""
    rng, known_sun = np.random.default_rng(seed + index), problem.scene.sun
    base = None if index == 0 else _direct(problem, light)
    coarse = _sub_sampled(problem, base, _SCAN_SAMPLES, rng)
    fine = _sub_sampled(problem, base, config.num_solve_surfels, rng)
    if index == 0 and known_sun is not None:
        candidates = [SunCandidate(axis=known_sun, loss=np.inf, gain=0.0)]
    else:
        scanned = scan(coarse, config.num_scan_directions, _NUM_CANDIDATES)
        candidates = _promising(scanned, is_first=index == 0)
    spacing = float(np.sqrt(4 * np.pi / config.num_scan_directions))
    reach = _SEARCH_REACH * spacing
    return side_by_side(lambda candidate: refine(fine, candidate, reach), candidates)


def _promising(candidates: list[SunCandidate], *, is_first: bool) -> list[SunCandidate]:
    """Those of a scan's candidates, best first, that a full solve may make a sun of."""
    least = _PROMISING * _LEAST_GAIN
    if is_first and candidates:
        # one that the scan does not see at all may still be known from its shadow
        best = candidates[0].gain
        least = _SECOND_BEST * best if best > _LEAST_GAIN else -np.inf
    return [candidate for candidate in candidates if candidate.gain > least]


def _shows(left: float) -> bool:
    """Whether the photographs show a shadow, by the share of the differences across it left."""
    return left < 1 - _LEAST_SHADOW_GAIN


def _left_across_shadow(problem: Problem, before: Light, after: Light) -> float:
    """Share of the differences across the shadow of the sun added last that this sun leaves."""
    # a further lobe lowers the loss wherever the mesh is wrong; its own shadow tells a light
    (pairs,) = Sunlight.of(problem, after.axes[-1:]).across_shadows()
    if not len(pairs.first):
        return 1.0
    rows = problem.scene.rows
    radiance = problem.rows_radiance(rows)
    weights = PairWeights.of(pairs, radiance.clipped)
    losses = []
    for light in (before, after):
        log_albedo = log_ratio(radiance.linear, light.irradiance(problem, rows))
        losses.append(float(weights.loss(log_albedo)))
    return losses[1] / max(losses[0], 1e-9)


def _best_addition(
    problem: Problem, light: Light, candidates: list[SunCandidate], iterations: int
) -> tuple[float, Light] | None:
    """The candidate whose full solve has the lowest loss, those that cast a shadow first.

    If all have a higher loss than without, that which evens its shadow best, by half or more: what
    mirrors or is nearly black may outweigh a shadow that everybody sees. A sun that the user knows
    needs no reason. With the share of the differences across its shadow that it leaves.
    """

    def may_be(candidate: SunCandidate) -> bool:
        # The search may have led it below the ground.
        if candidate.lit < candidate.least_lit:
            return False
        return not len(light.axes) or float((light.axes @ candidate.axis).max()) <= np.cos(
            SEPARATION
        )

    def solved(candidate: SunCandidate) -> tuple[float, Light]:
        axes = np.concatenate([light.axes, candidate.axis[None]])
        sharpness = np.append(light.sharpness, np.float32(_SHARPNESS))
        tried = fit(problem, axes, sharpness, iterations)
        return _left_across_shadow(problem, light, tried), tried

    tried = side_by_side(solved, filter(may_be, candidates))
    is_known = _is_told(problem, light)
    lower = [one for one in tried if is_known or one[1].loss <= light.loss]
    if lower:
        return min(lower, key=lambda one: (not _shows(one[0]), one[1].loss))
    plain = [one for one in tried if one[0] < _PLAIN_SHADOW]
    return min(plain, key=lambda one: one[0], default=None)


def polish(problem: Problem, light: Light, config: AppearanceConfig, seed: int) -> Light:
    """Directions and sizes of the suns with the whole light known, then the strengths for these."""
    axes, sharpness = light.axes.copy(), light.sharpness.copy()
    seen = np.flatnonzero(problem.radiance.seen)
    for index in range(len(axes)):
        others = np.arange(len(axes)) != index
        base = _direct(problem, light, others)
        rng = np.random.default_rng(seed + index)
        pairs = _polishing_pairs(problem, light, seen, rng)
        fine = SunProblem.of(problem, base, seen, pairs)
        start = SunCandidate(axis=axes[index], loss=np.inf, gain=0.0)
        axes[index] = refine(fine, start, _POLISH_REACH).axis
        sharpness[index] = _best_sharpness(problem, light, axes, sharpness, index)
    steps = config.iterations // 2
    polished = fit(problem, axes, sharpness, steps, start=light.amplitudes)
    return replace(polished, history=light.history)


def _polishing_pairs(
    problem: Problem, light: Light, rows: NDArray[np.int64], rng: np.random.Generator
) -> Pairs:
    """Pairs of samples `rows` (U,) on level ground, those alike under the light counting more."""
    surfels = problem.scene.transport.surfels
    pairs = neighbour_pairs(surfels, rows, PAIR_REACHES, _POLISH_PARTNERS, rng)
    pairs = pairs.facing_alike(surfels.normal[rows], _LEVEL_COSINE)
    log_albedo = log_ratio(problem.rows_radiance(rows).linear, light.irradiance(problem, rows))
    apart = ((log_albedo[pairs.first] - log_albedo[pairs.second]) ** 2).mean(1)
    return pairs.weighted(torch.exp(-0.5 * apart / _ALIKE_ALBEDO**2))


def _best_sharpness(
    problem: Problem, light: Light, axes: Floats, sharpness: Floats, index: int
) -> float:
    """Size of a sun, by the neighbour loss at fixed strengths."""
    rows = problem.scene.rows
    radiance = problem.rows_radiance(rows)
    weights = PairWeights.of(problem.scene.pairs, radiance.clipped)
    best, best_loss = float(sharpness[index]), np.inf
    for trial in _TRIED_SHARPNESS:
        tried = sharpness.copy()
        tried[index] = trial
        sharp = problem.scene.sharp_transfer(axes, tried, rows)
        irradiance = light.amplitudes.irradiance(problem.transfer(sharp, rows))
        log_albedo = log_ratio(radiance.linear, irradiance)
        loss = float(weights.loss(log_albedo))
        if loss < best_loss:
            best, best_loss = trial, loss
    return best


def _direct(problem: Problem, light: Light, others: NDArray[np.bool_] | None = None) -> Tensor:
    """Irradiance (S, 3) of the light without bounces, with only some of its sharp lobes."""
    everything = np.arange(len(problem.scene.transport.surfels))
    chosen = np.ones(len(light.axes), bool) if others is None else others
    sharp = problem.scene.sharp_transfer(light.axes[chosen], light.sharpness[chosen], everything)
    strength = light.amplitudes.sharp[torch.from_numpy(chosen)]
    return problem.scene.soft @ light.amplitudes.soft + sharp @ strength


def _sub_sampled(
    problem: Problem, base: Tensor | None, count: int, rng: np.random.Generator
) -> SunProblem:
    """So many samples, under a light that is known (S, 3) or under a grey sky."""
    scene, surfels = problem.scene, problem.scene.transport.surfels
    rows, per_reach = scene.rows, 2
    if count < len(rows):
        rows, per_reach = np.sort(rng.choice(rows, count, replace=False)), 1
    pairs = neighbour_pairs(surfels, rows, PAIR_REACHES, per_reach, rng)
    pairs = pairs.facing_alike(surfels.normal[rows], _ALIKE_COSINE)
    sky = scene.soft.sum(1)[:, None].expand(-1, 3) if base is None else base
    return SunProblem.of(problem, sky, rows, pairs)
