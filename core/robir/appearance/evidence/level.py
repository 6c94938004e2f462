# SPDX-License-Identifier: Apache-2.0
"""How bright the light as a whole is, by all that tells it.

Photographs of diffuse surfaces know light and albedo by their product alone. Three witnesses tell
the light's part of it, and their log likelihoods are added:

- Paints: how bright they commonly are.
- Exposure: photographs are exposed for the light that there is, as by an incident-light meter, so
  that white paint is about as bright as the brightest that a photograph shows.
- Highlights: what a specular layer on paint returns of sky and suns is known, F0 = 0.04: beside the
  diffuse light it is weaker the brighter the paint is. How views differ by it depends on the
  roughness too, so both are tried together, and what a brightness is worth is summed over all
  roughnesses, each patch of paint having its own. A highlight that the mesh puts in the wrong place
  would speak for a dim light, so each sample's normal may be as far off as the mesh's usually are.
"""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.special import logsumexp

from robir.appearance.evidence.witness import BY_ALL, Witness
from robir.appearance.light.lobes import BRIGHTEST_QUANTILE, log_ratio, log_sent
from robir.appearance.light.problem import Problem
from robir.appearance.light.solver import Light
from robir.appearance.material.config import HighlightsConfig, MaterialConfig
from robir.appearance.material.gloss import Gloss, clusters, diffuse_below
from robir.appearance.material.observed import looked_at
from robir.appearance.material.reflections import reflected_share

Reals = NDArray[np.float64]

FACTORS = np.linspace(-2.0, 3.0, 21)
"""Logs of the factors that are tried."""

PAINT = -1.85, 0.65
"""Mean and deviation of the mean log albedo of what photographs show: of the development
population, whose mean is .16; photography's mean scene reflects .18 (Jones and Condit 1941, "The
brightness scale of exterior scenes")."""

EXPOSURE = -0.15, 0.65
"""Mean and deviation of the log radiance of white paint in the mean light, 1 being what the plain
curve shows as white: of the development population."""

LIMIT = 0.1
"""How far, in log units, the brightest paint may seem to return more than it receives."""

MISREAD = 0.3
"""Deviation of the log factor that is left of one told by many views alike: where the mesh is more
wrong than is tried, highlights are missed and the light is told too dim."""

NUM_PATCHES = 16

MOST_SAMPLES = 450
"""Of the samples that take part in the light solve, looked at."""


def told_level(problem: Problem, light: Light, gloss: Gloss, seed: int) -> tuple[Witness, ...]:
    """What sky and suns likely send, of which diffuse surfaces tell the product with albedo alone.

    Args:
        problem: Scene under a tone curve, highlights included.
        light: Its light, of which all but the brightness as a whole is taken for right.
        gloss: Specular material under it; only what is no metal is asked.
        seed: Of the patches.

    Returns:
        What each witness tells of the mean over the channels of the log of the mean irradiance, all
        together last; of highlights only where some are known and enough views show them. Nothing
        where all is metal: paints and exposures of metal are not common ones.
    """
    chosen = problem.radiance.seen.numpy() & gloss.is_paint
    every = problem.scene.rows
    rows = every[chosen[every]]
    if not len(rows):
        return ()
    rows = rows[:: -(-len(rows) // MOST_SAMPLES) or 1]
    albedo = log_ratio(problem.radiance.linear[rows], light.irradiance(problem, rows)).numpy()
    sent = float(log_sent(light.irradiance(problem, every), problem.indirect[every]).mean())
    told = {"common paints": usual_paint(albedo), "exposure": usual_exposure(sent)}
    if gloss.has_highlights:
        errors, count = _errors(problem, light, rows, gloss.config)
        if count.sum() >= gloss.config.highlights.fewest_views:
            position = problem.scene.transport.surfels.position[rows]
            patch = clusters(np.concatenate([albedo, position], axis=1), NUM_PATCHES, seed)
            evidence = _evidence(errors, count, patch, gloss.config.highlights)
            told["highlights"] = misread(evidence)
    told[BY_ALL] = sum(told.values(), start=np.zeros(len(FACTORS)))
    return tuple(_witness(by, likely, sent) for by, likely in told.items())


def _witness(by: str, log_likely: Reals, sent: float) -> Witness:
    """Mean and deviation of the level under log likelihoods (FACTORS,), up to a constant."""
    likely = np.exp(log_likely - log_likely.max())
    likely /= likely.sum()
    mean = float(likely @ FACTORS)
    deviation = float(np.sqrt(likely @ (FACTORS - mean) ** 2))
    return Witness(of="level", by=by, value=sent + mean, deviation=deviation)


def _errors(
    problem: Problem, light: Light, rows: NDArray[np.int64], config: MaterialConfig
) -> tuple[Reals, Reals]:
    """Display errors (L, FACTORS, U) at every roughness, and the number (U,) of their views.

    Each is that of the normal, of those that the mesh's may stand for, which explains it best.
    """
    reflections, rays, seen, valid = looked_at(problem, light, rows, config)
    sample, size, levels = torch.from_numpy(rays.sample), len(rows), config.highlights.levels
    errors = np.full((len(levels), len(FACTORS), size), np.inf)
    for tilt in reflections.tilts:
        tilted = reflections.tilted(rays, tilt)
        for index, level in enumerate(levels):
            through = 1 - reflected_share(rays, level)[:, None]
            lit = reflections.from_sky(tilted, level) + reflections.from_suns(rays, level, tilt)
            for number, factor in enumerate(np.exp(FACTORS)):
                shone = factor * lit[:, 0]
                shown = diffuse_below(seen, shone, through, (rays, valid)) + shone
                total = torch.zeros(size).index_add_(0, sample, seen.error(shown)).double().numpy()
                errors[index, number] = np.minimum(errors[index, number], total)
    return errors, np.bincount(rays.sample, minlength=size).astype(np.float64)


def _evidence(
    errors: Reals, count: Reals, patch: NDArray[np.int64], config: HighlightsConfig
) -> Reals:
    """Log likelihood (FACTORS,), up to a constant, over all roughnesses of each patch (U,)."""
    views = np.bincount(patch, count)
    total = np.zeros(len(FACTORS))
    for known in np.flatnonzero(views >= config.fewest_views):
        codes = 255 * errors[:, :, patch == known].sum(2) / views[known]
        log = logsumexp(-config.steepness * np.log(codes + config.unseen_codes), axis=0)
        total += log * views[known] / (views[known] + config.half_believed)
    return misread(total)


def misread(evidence: Reals) -> Reals:
    """Log likelihood (FACTORS,) of what is true, from that of what is told."""
    missed = FACTORS[:, None] - FACTORS[None]
    return logsumexp(evidence - 0.5 * (missed / MISREAD) ** 2, axis=1)


def usual_paint(albedo: NDArray[np.floating]) -> Reals:
    """Log of how common the paints are, (FACTORS,), were the light so much brighter.

    Args:
        albedo: (U, 3) log albedo by the light as it is.
    """
    (usual, deviation), mean = PAINT, albedo.mean() - FACTORS
    brightest = np.quantile(albedo.max(1), BRIGHTEST_QUANTILE) - FACTORS
    return -0.5 * (((mean - usual) / deviation) ** 2 + (brightest.clip(0) / LIMIT) ** 2)


def usual_exposure(sent: float) -> Reals:
    """Log of how common it is to expose so, (FACTORS,), were the light so much brighter.

    Args:
        sent: Mean log irradiance by the light as it is.
    """
    usual, deviation = EXPOSURE
    white = sent - np.log(np.pi) + FACTORS
    return -0.5 * ((white - usual) / deviation) ** 2
