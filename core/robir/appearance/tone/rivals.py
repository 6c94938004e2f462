# SPDX-License-Identifier: Apache-2.0
"""Curves that fit as well as the one that is taken, and how far apart they put albedo."""

from __future__ import annotations

import numpy as np
from torch import Tensor

from robir.appearance.light.lobes import log_ratio
from robir.appearance.tone.ranking import SIMPLER_MARGIN, Candidate


def fits_alike(chosen: Candidate, other: Candidate) -> bool:
    """Whether the photographs do not tell another curve from the chosen one."""
    return other.score - chosen.score <= SIMPLER_MARGIN * other.standard_error


def albedo_apart(chosen: Candidate, other: Candidate) -> float | None:
    """PSNR in dB of the albedo under one curve against that under another, one scale a channel.

    Both are those of the samples that take part in the light solve, as far as neither is clipped,
    and under the light that was found with the curve; None where there are no such samples.
    """
    (first, is_whole), (second, is_whole_too) = _albedo(chosen), _albedo(other)
    whole = is_whole & is_whole_too
    if not whole.any():
        return None
    first, second = first[whole], second[whole]
    scale = (first * second).sum(0) / (second * second).sum(0).clamp(min=1e-12)
    squared = float(((first - scale * second) ** 2).mean())
    return float(-10 * np.log10(max(squared, 1e-10)))


def _albedo(candidate: Candidate) -> tuple[Tensor, Tensor]:
    """Albedo (U, 3), at most 1, and where no channel is clipped, (U,)."""
    problem, rows = candidate.problem, candidate.problem.scene.rows
    radiance = problem.rows_radiance(rows)
    albedo = log_ratio(radiance.linear, candidate.light.irradiance(problem, rows)).exp()
    return albedo.clamp(max=1.0), ~radiance.clipped.any(1)
