# SPDX-License-Identifier: Apache-2.0
"""Whether photographs went through the plain curve or through one with a shoulder.

Two signs are weighed, each by its own error. Albedos of one material must not differ between light
and shade; and highlights must be explained, see highlight_evidence.py. Where a sun meets one bright
material and one dark one, shadows alone may fit either curve.

Display errors of carried albedo cannot be the first sign: one error of the modelled light, such as
what a metal bottle throws on the ground and no bounce explains, shows as twice as many codes in the
bright under the plain curve as under Filmic, and as fewer in the dark. Nor can differences of log
albedo as they are, for one curve stretches all logarithms more than another. So these are taken
relative to the contrast of the light that was found under the same curve.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from robir.appearance.blocks import Table, difference_error, mean_of, table_of
from robir.appearance.light.lobes import log_ratio
from robir.appearance.light.problem import Problem
from robir.appearance.light.solver import Light

Reals = NDArray[np.floating[Any]]

_MISMATCH_CAP = 1.0  # mismatch beyond which a pair is of two materials and says nothing more
# mismatches by which curves differ for no reason; adds to their standard error. Blocks of one
# shadow err alike and agree better than they are right.
_MISMATCH_ERROR = 0.005
# display codes by which mean errors differ for no reason; adds to their standard error. Photographs
# hold whole codes, and where highlights are faint the errors of all curves agree too well from
# block to block.
CODE_ERROR = 0.1


@dataclass(frozen=True, slots=True, kw_only=True)
class Lead:
    """By how much an error is lower under the plain curve than under another.

    Attributes:
        value: The lead.
        error: Its standard error.
    """

    value: float
    error: float

    @property
    def errors(self) -> float:
        """The lead in standard errors."""
        return self.value / self.error

    @classmethod
    def of(cls, tables: tuple[Table, Table], unit: float, least: float) -> Lead:
        """From tables of the plain curve and of the other.

        Args:
            tables: Their errors by block.
            unit: By how much they are multiplied.
            least: Standard error, so multiplied, of a lead that all blocks agree on.
        """
        plain, other = tables
        value = unit * (mean_of(other) - mean_of(plain))
        return cls(value=value, error=float(np.hypot(unit * difference_error(plain, other), least)))


@dataclass(frozen=True, slots=True, kw_only=True)
class PlainLead:
    """How far a curve leads another, mostly a plain one the best of those with a shoulder.

    Attributes:
        plain: Name of the one.
        shoulder: Name of the other.
        shadows: By mismatch of albedo between light and shade.
        highlights: By display error near highlights, codes; None if none are seen.
        margin: Standard errors by which the one must lead.
    """

    plain: str
    shoulder: str
    shadows: Lead
    highlights: Lead | None
    margin: float

    @property
    def total(self) -> float:
        """Of both together, in standard errors: neither unit says what the other is worth."""
        leads = [self.shadows, *([self.highlights] if self.highlights else [])]
        return sum(lead.errors for lead in leads) / len(leads) ** 0.5

    @property
    def is_clear(self) -> bool:
        """Whether the photographs were made by the plain curve."""
        return self.total > self.margin

    @classmethod
    def of(
        cls,
        names: tuple[str, str],
        shadows: tuple[Table, Table],
        highlights: tuple[Table, Table] | None,
    ) -> PlainLead:
        """From tables of mismatches and of display errors, 0..1, in the order of the names."""
        return cls(
            plain=names[0],
            shoulder=names[1],
            shadows=Lead.of(shadows, 1.0, _MISMATCH_ERROR),
            highlights=Lead.of(highlights, 255.0, CODE_ERROR) if highlights else None,
            margin=0.0,
        )


def mismatch_table(
    problem: Problem, light: Light, blocks: NDArray[np.int64], weight: Reals
) -> Table:
    """Differences of log albedo over the mean difference of log irradiance.

    Clipped pairs say nothing.

    Args:
        problem: Scene under a tone curve.
        light: The light found under it.
        blocks: (2 P,) of every ordered pair.
        weight: (2 P,) by which pairs count, the same for all curves.
    """
    rows, pairs = problem.scene.rows, problem.scene.pairs
    irradiance = light.irradiance(problem, rows)
    radiance = problem.rows_radiance(rows)
    clipped = radiance.clipped.any(1)
    log_albedo = log_ratio(radiance.linear, irradiance)

    def apart(log: torch.Tensor) -> torch.Tensor:
        difference = (log[pairs.first] - log[pairs.second]).abs().mean(1)
        return torch.cat([difference, difference]).double()

    is_known = ~(clipped[pairs.first] | clipped[pairs.second]).numpy()
    told = weight * np.concatenate([is_known, is_known])
    contrast = float(told @ apart(irradiance.log()).numpy()) / max(told.sum(), 1e-9)
    mismatch = apart(log_albedo) / max(contrast, 1e-9)
    return table_of(blocks, mismatch.clamp(max=_MISMATCH_CAP).numpy(), told)
