# SPDX-License-Identifier: Apache-2.0
"""Standard errors over blocks against the scatter of repeated draws."""

from __future__ import annotations

import numpy as np

from robir.appearance.held_out_test import mean_error, mean_of, table_of


def test_the_error_of_a_mean_is_the_scatter_of_such_means():
    rng = np.random.default_rng(0)
    means, errors = [], []
    for _ in range(1000):
        block = np.repeat(np.arange(25), rng.integers(1, 30, 25))
        # what a block has in common errs with it; a mean far from 0 must not count as scatter
        value = 3.0 + rng.normal(0, 0.5, 25)[block] + rng.normal(0, 1, len(block))
        table = table_of(block, value, np.ones(len(block)))
        means.append(mean_of(table))
        errors.append(mean_error(table))
    scatter = np.std(means)
    # three standard errors of a deviation by 1000 draws are 7 %; few blocks tell a bit too little
    assert 0.88 * scatter < np.mean(errors) < 1.07 * scatter


def test_one_block_tells_no_error():
    block = np.zeros(5, int)
    assert mean_error(table_of(block, np.arange(5.0), np.ones(5))) == np.inf
