# SPDX-License-Identifier: Apache-2.0
"""Pieces on a board of points a unit apart."""

from __future__ import annotations

import numpy as np
import pytest

from robir.appearance.material.metal import pieces

GOLD, RED = np.array([0.55, 0.34, -0.89]), np.array([1.14, -0.53, -0.61])


def board(columns):
    """Places (10 * columns, 3) of a board."""
    across, along = np.meshgrid(np.arange(columns), np.arange(10.0), indexing="ij")
    return np.stack([across.ravel(), along.ravel(), np.zeros(across.size)], axis=1)


def hues(shares, spread=0.1):
    """Hues (N, 3) from gold, at a share of 0, to red, and deviations about them."""
    noise = np.random.default_rng(0).normal(0, spread, (len(shares), 3))
    return GOLD + shares[:, None] * (RED - GOLD) + noise


def test_two_hues_that_touch_and_blend_at_the_border_are_two():
    at = board(20)
    # over three columns one turns into the other, without a step
    number = pieces(at, hues(np.clip((at[:, 0] - 11) / 4, 0, 1)), 1.5, 8)
    assert len(np.unique(number)) == 2
    assert len(set(number[at[:, 0] <= 11])) == len(set(number[at[:, 0] >= 15])) == 1
    assert number[0] != number[-1]


@pytest.mark.parametrize("spread", [0.0, 0.1])
def test_a_hue_that_changes_evenly_is_one(spread):
    at = board(20)
    assert not pieces(at, hues(at[:, 0] / 19, spread), 1.5, 8).any()


@pytest.mark.parametrize(("fewest", "count"), [(8, 2), (20, 1)])
def test_a_few_of_another_hue_are_no_piece(fewest, count):
    at = board(20)
    number = pieces(at, hues(1.0 * (np.arange(len(at)) < 10), 0.02), 1.5, fewest)
    assert len(np.unique(number)) == count
