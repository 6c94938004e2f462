# SPDX-License-Identifier: Apache-2.0
"""How bright the light as a whole is, by the highlights of paint.

Photographs of diffuse surfaces know light and albedo by their product alone. What a highlight on
paint returns of a sun is known, F0 = 0.04: against the diffuse light of the same sun about it, a
highlight is weaker the brighter the paint is. How much of it a view shows depends on the roughness
as well, so both are tried together, and what a brightness is worth is summed over all roughnesses,
each patch of paint having its own.
"""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.special import logsumexp

from robir.appearance.gloss import SHARPEST_SKY, Gloss, clusters, diffuse_below, low_mean
from robir.appearance.highlights import FEWEST_VIEWS, HALF_BELIEVED, LEVELS, fit_of
from robir.appearance.light import log_ratio, log_sent
from robir.appearance.problem import Problem
from robir.appearance.reflections import reflected_share
from robir.appearance.roughness import MIN_HIGHLIGHTS
from robir.appearance.seen import looked_at
from robir.appearance.solver import Light

Reals = NDArray[np.float64]

FACTORS = np.linspace(-0.8, 0.8, 9)
"""Logs of the factors that are tried."""

USUAL = 0.3
"""How far the log mean albedo of scenes lies from that of common ones."""

SKY_BESIDE = 0.14
"""What the sky about a sun, brighter than lobes can show it, adds to the log of a highlight: on 12
rendered captures of 6 assets, whose highlights tell, .06 to .24 with a deviation of .05."""

MISREAD = 0.1
"""Error that is left of a brightness that many highlights tell alike."""

UNSURE = 0.2
"""Deviation of the log factor from which highlights do not tell. Where the mesh displaces them all,
they are missed where they should be: on two hotdogs and two still lifes, which came to .35 and
more, they told .3 to .6 less light than there was; on those twelve it was .04 to .14."""

NUM_PATCHES = 16

MOST_SAMPLES = 900
"""Of the samples that take part in the light solve, looked at."""


def level_by_highlights(problem: Problem, light: Light, gloss: Gloss, seed: int) -> float | None:
    """What sky and suns likely send, of which diffuse surfaces tell the product with albedo alone.

    Args:
        problem: Scene under a tone curve, highlights included.
        light: Its light, of which all but the brightness as a whole is taken for right.
        gloss: Specular material under it; only what is metal is asked.
        seed: Of the patches.

    Returns:
        Mean over the channels of the log of the mean irradiance, drawn towards that of `light` by
        how little highlights say; None where none tell.
    """
    if not gloss.has_highlights or not len(light.axes):
        return None
    chosen = problem.radiance.seen.numpy() & gloss.is_paint
    every = problem.scene.rows
    rows = every[:: -(-len(every) // MOST_SAMPLES)]
    rows = rows[chosen[rows]]
    errors, count = _errors(problem, light, rows)
    if count.sum() < MIN_HIGHLIGHTS:
        return None
    albedo = log_ratio(problem.radiance.linear[rows], light.irradiance(problem, rows))
    position = problem.scene.transport.surfels.position[rows]
    patch = clusters(np.concatenate([albedo.numpy(), position], axis=1), NUM_PATCHES, seed)
    factor = most_likely(_evidence(errors, count, patch))
    if factor is None:
        return None
    sent = log_sent(light.irradiance(problem, every), problem.indirect[every])
    return float(sent.mean()) + factor


def _errors(problem: Problem, light: Light, rows: NDArray[np.int64]) -> tuple[Reals, Reals]:
    """Display errors (FACTORS, LEVELS + 1, U) summed over near views, and the number (U,) of these.

    The last is without any highlight. The normals are the mesh's own: the best of several tilts
    would be a brighter highlight or a darker one as it suits.
    """
    reflections, rays, seen, valid = looked_at(problem, light, rows)
    near = reflections.near_highlight(rays)
    sample, near_seen = torch.from_numpy(rays.sample[near.numpy()]), seen.of(near)

    def summed(error: torch.Tensor) -> Reals:
        return torch.zeros(len(rows)).index_add_(0, sample, error).double().numpy()

    plain = low_mean(seen.linear, rays, valid)[rays.sample]
    errors = np.empty((len(FACTORS), len(LEVELS) + 1, len(rows)))
    errors[:, -1] = summed(near_seen.error(plain[near]))
    for index, level in enumerate(LEVELS):
        through = 1 - reflected_share(rays, level)[:, None]
        lit = reflections.from_sky(rays, max(level, SHARPEST_SKY))
        lit = (lit + reflections.from_suns(rays, level))[:, 0]
        for number, factor in enumerate(np.exp(FACTORS)):
            shone = factor * lit
            shown = diffuse_below(seen.linear, shone, through, (rays, valid)) + shone
            errors[number, index] = summed(near_seen.error(shown[near]))
    return errors, np.bincount(sample.numpy(), minlength=len(rows)).astype(np.float64)


def _evidence(errors: Reals, count: Reals, patch: NDArray[np.int64]) -> Reals:
    """Log likelihood (FACTORS,), up to a constant, over all roughnesses of each patch (U,)."""
    views = np.bincount(patch, count)
    total = np.zeros(len(errors))
    for known in np.flatnonzero(views >= FEWEST_VIEWS):
        codes = 255 * errors[:, :, patch == known].sum(2) / views[known]
        log = fit_of(codes[:, :-1], codes[:, -1]) * views[known] / (views[known] + HALF_BELIEVED)
        total += logsumexp(log, axis=1)
    return total


def most_likely(evidence: Reals) -> float | None:
    """The log factor between those tried, each evidence (FACTORS,) beside what is usual.

    Args:
        evidence: Log likelihood of each of them.
    """
    best = int(np.clip(evidence.argmax(), 1, len(FACTORS) - 2))
    before, at, after = evidence[best - 1 : best + 2]
    step = FACTORS[1] - FACTORS[0]
    bend = 2 * at - before - after
    variance = step**2 / max(bend, 1e-9)
    if variance > UNSURE**2:
        return None
    told = FACTORS[best] + step * np.clip((after - before) / (2 * bend), -1, 1) - SKY_BESIDE
    return float(told * USUAL**2 / (USUAL**2 + MISREAD**2 + variance))
