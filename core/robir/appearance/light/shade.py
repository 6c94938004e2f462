# SPDX-License-Identifier: Apache-2.0
"""Pairs of samples across a shadow: which count, and how much."""

from __future__ import annotations

from torch import Tensor

from robir.appearance.photometry.statistics import STEP_WIDTH, Pairs

# difference in hue, beyond the step common to all pairs, at which two samples hardly are one
# material (log albedo)
ALIKE_HUE = 0.1
ALIKE_BRIGHTNESS = 0.35  # the same in brightness. The fields of a board are 0.8 apart (log albedo)
# error of the irradiance that mesh and bounces leave, over its mean: what hardly any light reaches
# has an albedo that nobody knows
LIGHT_ERROR = 0.05


def irradiance_doubt(irradiance: Tensor) -> Tensor:
    """One standard deviation (N,) of the logarithm of an irradiance (N, 3)."""
    return LIGHT_ERROR * irradiance.mean() / irradiance.mean(1).clamp(min=1e-6)


def well_lit(parts: list[Pairs], irradiance: Tensor) -> list[Pairs]:
    """Pairs, a list a sun, shaded end first, weighted by how well its irradiance is known.

    In the gap below an object a mesh that is a trifle off changes the light (U, 3) by half.
    """
    doubt = irradiance_doubt(irradiance)
    doubt = doubt / STEP_WIDTH
    return [part.weighted(1 / (1 + doubt[part.first] ** 2)) for part in parts]


def of_one_material(parts: list[Pairs], log_albedo: Tensor, clipped: Tensor) -> Pairs:
    """Pairs of all suns, weighted by how alike they are but for the step that all share.

    Of pairs a sun, the end out of its light first, log albedo (U, 3), and clipped channels (U, 3).
    """
    weighted = []
    for part in parts:
        step = part.of(part.unclipped(clipped)).common_step(log_albedo)
        alike = part.likeness(log_albedo, ALIKE_HUE, ALIKE_BRIGHTNESS, step)
        weighted.append(part.weighted(alike))
    return Pairs.joined(weighted)
