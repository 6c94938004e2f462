# SPDX-License-Identifier: Apache-2.0
"""How bright the light as a whole is, by what paint reflects of it.

Photographs of diffuse surfaces know light and albedo by their product alone. What a specular layer
on paint returns of sky and suns is known, F0 = 0.04: beside the diffuse light it is weaker the
brighter the paint is. How views differ by it depends on the roughness too, so both are tried
together, and what a brightness is worth is summed over all roughnesses, each patch of paint having
its own. A highlight that the mesh puts in the wrong place would speak for a dim light, so each
sample's normal may be as far off as the mesh's usually are. Where no specular layer was found all
the same, that the light is dimmer is not believed.
"""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.special import logsumexp

from robir.appearance.light.lobes import BRIGHTEST_QUANTILE, MEAN_ALBEDO, log_ratio, log_sent
from robir.appearance.light.problem import Problem
from robir.appearance.light.solver import Light
from robir.appearance.material.gloss import Gloss, clusters, diffuse_below
from robir.appearance.material.highlights import (
    FEWEST_VIEWS,
    HALF_BELIEVED,
    LEVELS,
    STEEPNESS,
    UNSEEN_CODES,
)
from robir.appearance.material.observed import looked_at
from robir.appearance.material.reflections import TILTS, reflected_share

Reals = NDArray[np.float64]

FACTORS = np.linspace(-2.0, 3.0, 21)
"""Logs of the factors that are tried."""

USUAL = 0.9
"""Deviation of the log of a scene's mean albedo: that of factors over the paints of the development
population."""

LIMIT = 0.1
"""How far, in log units, the brightest paint may seem to return more than it receives."""

MISREAD = 0.3
"""Deviation of the log factor that is left of one told by many views alike: where the mesh is more
wrong than is tried, highlights are missed and the light is told too dim."""

TOLD_DIM = 0.2
"""Log factor by which light is told too dim in the middle of the development population: .17 on a
ground, .46 without."""

NUM_PATCHES = 16

MOST_SAMPLES = 450
"""Of the samples that take part in the light solve, looked at."""


def level_by_highlights(problem: Problem, light: Light, gloss: Gloss, seed: int) -> float | None:
    """What sky and suns likely send, of which diffuse surfaces tell the product with albedo alone.

    Args:
        problem: Scene under a tone curve, highlights included.
        light: Its light, of which all but the brightness as a whole is taken for right.
        gloss: Specular material under it; only what is no metal is asked.
        seed: Of the patches.

    Returns:
        Mean over the channels of the log of the mean irradiance: the likeliest by what views show
        of reflections and by how bright paints commonly are. None where too few views show any.
    """
    chosen = problem.radiance.seen.numpy() & gloss.is_paint
    every = problem.scene.rows
    rows = every[chosen[every]]
    rows = rows[:: -(-len(rows) // MOST_SAMPLES) or 1]
    albedo = log_ratio(problem.radiance.linear[rows], light.irradiance(problem, rows)).numpy()
    errors, count = _errors(problem, light, rows)
    if count.sum() < FEWEST_VIEWS:
        return None
    position = problem.scene.transport.surfels.position[rows]
    patch = clusters(np.concatenate([albedo, position], axis=1), NUM_PATCHES, seed)
    sent = log_sent(light.irradiance(problem, every), problem.indirect[every])
    factor = expected(_evidence(errors, count, patch) + usual(albedo))
    return float(sent.mean()) + (factor if gloss.has_highlights else max(factor, 0.0))


def _errors(problem: Problem, light: Light, rows: NDArray[np.int64]) -> tuple[Reals, Reals]:
    """Display errors (LEVELS, FACTORS, U) summed over views, and the number (U,) of these.

    Each is that of the normal, of those that the mesh's may stand for, which explains it best.
    """
    reflections, rays, seen, valid = looked_at(problem, light, rows)
    sample, size = torch.from_numpy(rays.sample), len(rows)
    errors = np.full((len(LEVELS), len(FACTORS), size), np.inf)
    for tilt in TILTS:
        tilted = reflections.tilted(rays, tilt)
        for index, level in enumerate(LEVELS):
            through = 1 - reflected_share(rays, level)[:, None]
            lit = reflections.from_sky(tilted, level) + reflections.from_suns(rays, level, tilt)
            for number, factor in enumerate(np.exp(FACTORS)):
                shone = factor * lit[:, 0]
                shown = diffuse_below(seen.linear, shone, through, (rays, valid)) + shone
                total = torch.zeros(size).index_add_(0, sample, seen.error(shown)).double().numpy()
                errors[index, number] = np.minimum(errors[index, number], total)
    return errors, np.bincount(rays.sample, minlength=size).astype(np.float64)


def _evidence(errors: Reals, count: Reals, patch: NDArray[np.int64]) -> Reals:
    """Log likelihood (FACTORS,), up to a constant, over all roughnesses of each patch (U,)."""
    views = np.bincount(patch, count)
    total = np.zeros(len(FACTORS))
    for known in np.flatnonzero(views >= FEWEST_VIEWS):
        codes = 255 * errors[:, :, patch == known].sum(2) / views[known]
        log = logsumexp(-STEEPNESS * np.log(codes + UNSEEN_CODES), axis=0)
        total += log * views[known] / (views[known] + HALF_BELIEVED)
    return misread(total)


def misread(evidence: Reals) -> Reals:
    """Log likelihood (FACTORS,) of what is true, from that of what is told."""
    missed = FACTORS[:, None] - FACTORS[None] - TOLD_DIM
    return logsumexp(evidence - 0.5 * (missed / MISREAD) ** 2, axis=1)


def usual(albedo: NDArray[np.floating]) -> Reals:
    """Log of how common the paints are, (FACTORS,), were the light so much brighter.

    Args:
        albedo: (U, 3) log albedo by the light as it is.
    """
    mean = albedo.mean() - FACTORS
    brightest = np.quantile(albedo.max(1), BRIGHTEST_QUANTILE) - FACTORS
    common = ((mean - np.log(MEAN_ALBEDO)) / USUAL) ** 2
    return -0.5 * (common + (brightest.clip(0) / LIMIT) ** 2)


def expected(log_likely: Reals) -> float:
    """Mean log factor.

    Args:
        log_likely: (FACTORS,) up to a constant.
    """
    likely = np.exp(log_likely - log_likely.max())
    return float(likely @ FACTORS / likely.sum())
