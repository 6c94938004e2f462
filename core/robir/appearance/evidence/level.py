# SPDX-License-Identifier: Apache-2.0
"""How bright the light as a whole is, by all that tells it.

Photographs of diffuse surfaces know light and albedo by their product alone. Four witnesses tell
the light's part of it, and their log likelihoods are added:

- Paints: how bright they commonly are.
- Exposure: photographs are exposed for the light that there is, as by an incident-light meter, so
  that white paint is about as bright as the brightest that a photograph shows.
- Metal: how bright the base colours of metals are, as what they mirror is read.
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

from robir.appearance.config import AppearanceConfig
from robir.appearance.evidence.config import LevelConfig
from robir.appearance.evidence.witness import BY_ALL, Witness
from robir.appearance.light.lobes import log_ratio, log_sent
from robir.appearance.light.problem import Problem
from robir.appearance.light.solver import Light
from robir.appearance.material.gloss import Gloss
from robir.appearance.material.observed import diffuse_below, looked_at
from robir.appearance.material.reflections import reflected_share
from robir.appearance.material.segments import clusters

Reals = NDArray[np.float64]


def log_factors(config: LevelConfig) -> Reals:
    """Logs of the factors that are tried on the light, (F,)."""
    return np.linspace(config.darkest, config.brightest, config.num_factors)


def told_level(
    problem: Problem, light: Light, gloss: Gloss, solved: NDArray[np.int64], seed: int
) -> tuple[Witness, ...]:
    """What sky and suns likely send, of which diffuse surfaces tell the product with albedo alone.

    Args:
        problem: Scene under a tone curve, highlights included.
        light: Its light, of which all but the brightness as a whole is taken for right.
        gloss: Specular material under it.
        solved: Samples by which the light is solved: of what these receive the level is told.
        seed: Of the patches.

    Returns:
        What each witness tells of the mean over the channels of the log of the mean irradiance, all
        together last; of highlights only where some are known and enough views show them. Nothing
        where all is metal: paints and exposures of metal are not common ones.
    """
    config = problem.scene.config
    asked = config.evidence.level
    chosen = problem.radiance.seen.numpy() & gloss.is_paint
    every = problem.scene.rows
    rows = every[chosen[every]]
    if not len(rows):
        return ()
    rows = rows[:: -(-len(rows) // asked.num_samples) or 1]
    albedo = log_ratio(problem.radiance.linear[rows], light.irradiance(problem, rows)).numpy()
    sent = float(log_sent(light.irradiance(problem, solved), problem.indirect[solved]).mean())
    told = {"common paints": usual_paint(albedo, config), "exposure": usual_exposure(sent, asked)}
    if gloss.has_highlights:
        errors, count = _errors(problem, light, rows, log_factors(asked))
        if count.sum() >= config.material.highlights.fewest_views:
            position = problem.scene.transport.surfels.position[rows]
            patch = clusters(np.concatenate([albedo, position], axis=1), asked.num_patches, seed)
            told["highlights"] = misread(_evidence(errors, count, patch, config), asked)
    if gloss.metal_reads is not None:
        told["metal"] = usual_metal(gloss.metal_reads, config)
    told[BY_ALL] = sum(told.values(), start=np.zeros(asked.num_factors))
    return tuple(_witness(by, likely, sent, asked) for by, likely in told.items())


def _witness(by: str, log_likely: Reals, sent: float, config: LevelConfig) -> Witness:
    """Mean and deviation of the level under log likelihoods (F,), up to a constant."""
    factors = log_factors(config)
    likely = np.exp(log_likely - log_likely.max())
    likely /= likely.sum()
    mean = float(likely @ factors)
    deviation = float(np.sqrt(likely @ (factors - mean) ** 2))
    return Witness(of="level", by=by, value=sent + mean, deviation=deviation)


def _errors(
    problem: Problem, light: Light, rows: NDArray[np.int64], factors: Reals
) -> tuple[Reals, Reals]:
    """Display errors (L, F, U) at every roughness, and the number (U,) of their views.

    Each is that of the normal, of those that the mesh's may stand for, which explains it best.
    """
    config = problem.scene.config
    levels, statistics = config.material.highlights.levels, config.photometry.statistics
    reflections, rays, seen, valid = looked_at(problem, light, rows)
    sample, size, seen_by = torch.from_numpy(rays.sample), len(rows), (rays, valid)
    errors = np.full((len(levels), len(factors), size), np.inf)
    for tilt in reflections.tilts:
        tilted = reflections.tilted(rays, tilt)
        for index, level in enumerate(levels):
            through = 1 - reflected_share(rays, level)[:, None]
            lit = reflections.from_sky(tilted, level) + reflections.from_suns(rays, level, tilt)
            for number, factor in enumerate(np.exp(factors)):
                shone = factor * lit[:, 0]
                shown = diffuse_below(seen, shone, through, seen_by, statistics) + shone
                total = torch.zeros(size).index_add_(0, sample, seen.error(shown)).double().numpy()
                errors[index, number] = np.minimum(errors[index, number], total)
    return errors, np.bincount(rays.sample, minlength=size).astype(np.float64)


def _evidence(
    errors: Reals, count: Reals, patch: NDArray[np.int64], config: AppearanceConfig
) -> Reals:
    """Log likelihood (F,), up to a constant, over all roughnesses of each patch (U,)."""
    views, reading = np.bincount(patch, count), config.material.highlights
    total = np.zeros(config.evidence.level.num_factors)
    for known in np.flatnonzero(views >= reading.fewest_views):
        codes = 255 * errors[:, :, patch == known].sum(2) / views[known]
        log = logsumexp(-reading.steepness * np.log(codes + reading.unseen_codes), axis=0)
        total += log * views[known] / (views[known] + reading.half_believed)
    return total


def misread(evidence: Reals, config: LevelConfig) -> Reals:
    """Log likelihood (F,) of what is true, from that of what is told."""
    factors = log_factors(config)
    missed = factors[:, None] - factors[None]
    return logsumexp(evidence - 0.5 * (missed / config.misread) ** 2, axis=1)


def usual_paint(albedo: NDArray[np.floating], config: AppearanceConfig) -> Reals:
    """Log of how common the paints are, (F,), were the light so much brighter.

    Args:
        albedo: (U, 3) log albedo by the light as it is.
        config: What is common.
    """
    asked = config.evidence.level
    factors, rank = log_factors(asked), config.light.lobes.brightest_quantile
    mean = (albedo.mean() - factors - asked.paint) / asked.paint_spread
    brightest = np.quantile(albedo.max(1), rank) - factors
    return -0.5 * (mean**2 + (brightest.clip(0) / asked.excess) ** 2)


def usual_metal(read: float, config: AppearanceConfig) -> Reals:
    """Log of how common metals as bright are, (F,), were the light so much brighter.

    Args:
        read: Log of the brightest channel of base colours by the light as it is.
        config: What metals there are, and how well they are read.
    """
    metal, likely = config.material.metal, np.zeros(config.evidence.level.num_factors)
    off = read - log_factors(config.evidence.level) - metal.brightness
    for share, error in (
        (1 - metal.misread_share, metal.brightness_error),
        (metal.misread_share, metal.misread_error),
    ):
        deviation = np.hypot(error, metal.brightness_spread)
        likely += share / deviation * np.exp(-0.5 * (off / deviation) ** 2)
    return np.log(likely)


def usual_exposure(sent: float, config: LevelConfig) -> Reals:
    """Log of how common it is to expose so, (F,), were the light so much brighter.

    Args:
        sent: Mean log irradiance by the light as it is.
        config: What is common.
    """
    white = sent - np.log(np.pi) + log_factors(config)
    return -0.5 * ((white - config.exposure) / config.exposure_spread) ** 2
