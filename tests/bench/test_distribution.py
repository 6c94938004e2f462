# SPDX-License-Identifier: Apache-2.0
"""Quantiles, shares and their bootstrap intervals, against closed forms and scipy's bootstrap."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from robir_bench.distribution import CONFIDENCE, estimate, mean, quantile

TAIL = 0.5 * (1.0 - CONFIDENCE)


@pytest.mark.parametrize("count", [5, 9, 15, 31])
def test_the_interval_of_a_median_is_the_exact_bootstraps(count):
    """The resampled median is at most the k-th smallest value if more than half of the draws are.

    The number of draws among the k smallest of n is binomial with share k / n (Efron 1979), so the
    bootstrap distribution of the median is known without drawing at all.
    """
    values = np.sort(np.random.default_rng(count).normal(size=count))
    k = np.arange(1, count + 1)
    at_most = stats.binom.sf(count // 2, count, k / count)
    expected = [values[np.searchsorted(at_most, share)] for share in (TAIL, 1.0 - TAIL)]
    found = estimate(list(values[::-1]), quantile(0.5))
    assert found.value == values[count // 2]
    assert [found.low, found.high] == expected
    assert found.count == count


@pytest.mark.parametrize("statistic", [mean, quantile(0.1), quantile(0.9)])
def test_intervals_agree_with_those_of_scipy(statistic):
    values = np.random.default_rng(3).gamma(2.0, size=60)
    theirs = stats.bootstrap(
        (values,),
        lambda sample, axis: statistic(np.moveaxis(sample, axis, -1)),
        confidence_level=CONFIDENCE,
        method="percentile",
        n_resamples=20_000,
    ).confidence_interval
    found = estimate(list(values), statistic)
    width = theirs.high - theirs.low
    assert found.low == pytest.approx(theirs.low, abs=0.08 * width)
    assert found.high == pytest.approx(theirs.high, abs=0.08 * width)


def test_few_values_say_so():
    assert estimate([], mean) is None
    lone = estimate([2.5], quantile(0.5))
    assert (lone.value, lone.low, lone.high) == (2.5, None, None)
    assert lone.text(1) == "2.5"
    assert estimate([1.0, 1.0], mean).text(2) == "1.00 [1.00, 1.00]"
