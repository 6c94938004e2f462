# SPDX-License-Identifier: Apache-2.0
"""Figures of a population: quantiles and shares, and how sure they are."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Statistic = Callable[[Floats], Floats]  # takes samples (..., N), returns one number each (...)

RESAMPLES = 4000
CONFIDENCE = 0.9


@dataclass(frozen=True, slots=True, kw_only=True)
class PopulationFigure:
    """A figure of a population, estimated from some captures of it."""

    value: float  # the figure of these captures
    low: float | None  # lower end of its interval; None where fewer than two captures tell
    high: float | None  # upper end
    count: int  # captures that it rests on

    def text(self, digits: int) -> str:
        """The figure and its interval as shown, such as "21.3 [19.8, 22.4]"."""
        shown = f"{self.value:.{digits}f}"
        if self.low is None or self.high is None:
            return shown
        return f"{shown} [{self.low:.{digits}f}, {self.high:.{digits}f}]"


def quantile(share: float) -> Statistic:
    """The statistic below which a share of a sample lies, interpolated linearly between values."""
    return lambda samples: np.quantile(samples, share, axis=-1)


def worst_tenth(values: Sequence[float], badness: Callable[[float], float]) -> float:
    """The value that nine in ten, or more, are no worse than; `badness` is larger for worse."""
    ranked = sorted(values, key=badness)
    return ranked[-(-9 * len(ranked) // 10) - 1]


def mean(samples: Floats) -> Floats:
    """The statistic that is a share where samples are 0 and 1."""
    return samples.mean(axis=-1)


def estimate(values: Sequence[float], statistic: Statistic) -> PopulationFigure | None:
    """A statistic of a sample with its percentile bootstrap interval (Efron 1979).

    Captures are drawn with replacement, as many as there are, RESAMPLES times; between the
    quantiles of what the statistic then is lies CONFIDENCE of it. Always the same draws, so that
    equal scores give equal tables. With few captures such an interval is too narrow.

    Args:
        values: One of each capture, finite.
        statistic: What to estimate.

    Returns:
        The estimate, or None where there are no values.
    """
    sample = np.asarray(values, np.float64)
    if len(sample) == 0:
        return None
    found = float(statistic(sample))
    if len(sample) == 1:
        return PopulationFigure(value=found, low=None, high=None, count=1)
    drawn = np.random.default_rng(0).integers(len(sample), size=(RESAMPLES, len(sample)))
    tail = 0.5 * (1.0 - CONFIDENCE)
    low, high = np.quantile(statistic(sample[drawn]), (tail, 1.0 - tail))
    return PopulationFigure(value=found, low=float(low), high=float(high), count=len(sample))
