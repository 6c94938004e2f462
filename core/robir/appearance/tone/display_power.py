# SPDX-License-Identifier: Apache-2.0
"""Whether the photographs were re-toned by a power after their tone curve.

A power of the display code multiplies all logarithms of radiance by nearly one factor, so ratios
stay consistent across every shadow, and what `tone_choice` compares cannot see it. What can is that
light adds up: sun, sky and bounces explain the shading of one material under the true curve, and no
sum of lights explains a power of it. So the light is fitted under each power, and pairs of samples
vote for it whose albedos come out alike, alike being measured by the contrast that the power
leaves.

The votes alone are wrong now and then (docs/tone.md), so they are asked only where there is reason
to: a power below 1 leaves photographs bright all over, one above 1 dark. They fix a power to about
a fifth either way, so only whole octaves are tried, and one other than 1 is taken only if it leads
1 and leads its reciprocal clearly.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch

from robir.appearance.blocks import Table, difference_error, mean_of, table_of
from robir.appearance.light.lobes import log_ratio
from robir.appearance.light.problem import (
    PAIR_REACHES,
    PARTNERS,
    Problem,
    Scene,
    blocks_of,
    make_problem,
)
from robir.appearance.light.solver import Light, fit
from robir.appearance.photometry.statistics import neighbour_pairs
from robir.maths.tone import powered
from robir.maths.tone_curve import AbstractToneCurve

POWERS = (0.5, 1.0, 2.0)

USUAL_LEVEL = (0.4, 0.66)
"""Mean display code of photographs as they are taken; between these no power is asked for."""

NUM_SAMPLES = 2000
ITERATIONS = 80

ALIKE = 0.24
"""Difference of log albedo at which a vote has fallen to 1 / e, over the mean deviation of log
radiance."""

CONTRAST = (0.4, 2.0)
"""Differences of log irradiance, over the same, from which a pair counts and beyond which it counts
no more."""

LEAD_OF_ONE = 1.0
"""Standard errors by which a power must lead the power 1."""

LEAD_OF_OPPOSITE = 2.5
"""Standard errors by which it must lead its reciprocal. Errors of the mesh may favour a neighbour
of the true power, hardly a whole slope."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PowerChoice:
    """The power with what it was chosen by.

    Attributes:
        power: The choice.
        level: Mean display code of the samples, 0..1.
        votes: Share of the pairs whose albedos agree, for each of POWERS; empty if not asked for.
    """

    power: float
    level: float
    votes: tuple[float, ...]


def choose_power(
    scene: Scene, curves: Sequence[AbstractToneCurve], light: Light, seed: int
) -> PowerChoice:
    """Try POWERS of a curve on some of the samples.

    Args:
        scene: Samples with their transport.
        curves: The one whose powers are tried, and others that differ from it much as a power does:
            a power must lead these, too.
        light: Suns that were found under it; their strengths are fitted anew.
        seed: Of the samples.

    Returns:
        The power; 1 unless another clearly leads.
    """
    observations = scene.transport.observations
    level = float(observations.display[observations.weight > 0].mean() / 255)
    if USUAL_LEVEL[0] <= level <= USUAL_LEVEL[1]:
        return PowerChoice(power=1.0, level=level, votes=())
    few = _subset(scene, np.random.default_rng(seed))
    blocks = blocks_of(few)

    def votes(curve: AbstractToneCurve) -> Table:
        problem = make_problem(few, curve)
        solved = fit(problem, light.axes, light.sharpness, ITERATIONS)
        return table_of(blocks, *_votes(problem, solved))

    first, *others = curves
    tables = [votes(powered(first, power)) for power in POWERS]
    one = POWERS.index(1.0)
    tables[one] = max([tables[one], *map(votes, others)], key=mean_of)
    power = leading_power(tables, level)
    return PowerChoice(power=power, level=level, votes=tuple(map(mean_of, tables)))


def leading_power(tables: list[Table], level: float) -> float:
    """The power that the level asks for if its votes lead enough, else 1.

    Args:
        tables: Votes by blocks for each of POWERS.
        level: Mean display code, 0..1.
    """
    low, one, high = tables
    is_bright = level > USUAL_LEVEL[1]
    mine, opposite = (low, high) if is_bright else (high, low)
    lead = mean_of(mine) - mean_of(one)
    slope = mean_of(mine) - mean_of(opposite)
    leads = lead > LEAD_OF_ONE * difference_error(mine, one)
    slopes = slope > LEAD_OF_OPPOSITE * difference_error(mine, opposite)
    return (POWERS[0] if is_bright else POWERS[2]) if leads and slopes else 1.0


def _subset(scene: Scene, rng: np.random.Generator) -> Scene:
    """The scene with fewer samples in the light solve."""
    if len(scene.rows) <= NUM_SAMPLES:
        return scene
    rows = np.sort(rng.choice(scene.rows, NUM_SAMPLES, replace=False))
    pairs = neighbour_pairs(scene.transport.surfels, rows, PAIR_REACHES, PARTNERS, rng)
    return replace(scene, rows=rows, pairs=pairs)


def _votes(problem: Problem, light: Light) -> tuple[np.ndarray, np.ndarray]:
    """Vote, 0..1, and weight of every ordered pair, (2 P,) each."""
    scene = problem.scene
    irradiance = light.irradiance(problem, scene.rows)
    radiance = problem.rows_radiance(scene.rows)
    log_radiance = radiance.linear.log()
    deviation = float((log_radiance - log_radiance.mean(0)).abs().mean())
    log_albedo = log_ratio(radiance.linear, irradiance)
    first = torch.cat([scene.pairs.first, scene.pairs.second])
    second = torch.cat([scene.pairs.second, scene.pairs.first])
    apart = (log_albedo[first] - log_albedo[second]).abs().mean(1) / deviation
    contrast = (irradiance[first].log() - irradiance[second].log()).abs().mean(1) / deviation
    weight = (contrast.clamp(max=CONTRAST[1]) - CONTRAST[0]).clamp(min=0)
    weight = weight.masked_fill((radiance.clipped[first] | radiance.clipped[second]).any(1), 0)
    return torch.exp(-((apart / ALIKE) ** 2)).double().numpy(), weight.double().numpy()
