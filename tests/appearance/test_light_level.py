# SPDX-License-Identifier: Apache-2.0
"""A ball of two paints, whose light is known but for its brightness."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from appearance import synthetic

from robir.appearance.config import AppearanceConfig
from robir.appearance.gloss import estimate_gloss
from robir.appearance.light import log_sent
from robir.appearance.light_level import (
    FACTORS,
    MISREAD,
    SKY_BESIDE,
    USUAL,
    level_by_highlights,
    most_likely,
)
from robir.appearance.problem import make_problem
from robir.appearance.solver import refit
from robir.maths.tone import curve_from_name

RED = synthetic.Material(np.float32([0.45, 0.12, 0.1]), 0.45)
BLUE = synthetic.Material(np.float32([0.1, 0.25, 0.5]), 0.7)


@pytest.fixture(scope="module")
def ball():
    """The problem and its light."""
    light, curve = synthetic.sun_and_uneven_sky(), curve_from_name("filmic")
    halves = [(lambda at: at[:, 1] > 0, RED), (lambda at: at[:, 1] <= 0, BLUE)]
    return make_problem(synthetic.ball(halves, light, curve)[0], curve), light


def level_of(problem, light):
    """Mean over the channels of the log of the mean irradiance from sky and suns."""
    rows = problem.scene.rows
    return float(log_sent(light.irradiance(problem, rows), problem.indirect[rows]).mean())


@pytest.mark.parametrize("wrong", [-0.4, 0.0, 0.4])
def test_highlights_tell_the_brightness(ball, wrong):
    problem, light = ball
    supposed = light.tinted(torch.full((3,), wrong))
    gloss, _ = estimate_gloss(problem, supposed, 2, 0)
    told = level_by_highlights(problem, supposed, gloss, 0)
    assert told is not None
    # half of what is told wrongly is what the sky about a sun adds elsewhere, but not here
    assert told == pytest.approx(level_of(problem, light), abs=0.2)


def test_without_highlights_no_brightness_is_told(ball):
    problem, light = ball
    gloss, _ = estimate_gloss(problem, light, 2, 0)
    assert level_by_highlights(problem, light, replace(gloss, has_highlights=False), 0) is None
    all_metal = replace(gloss, metallic=np.ones_like(gloss.metallic))
    assert level_by_highlights(problem, light, all_metal, 0) is None


def test_the_less_highlights_say_the_less_is_changed():
    def told(deviation):
        return most_likely(-0.5 * ((FACTORS - 0.5) / deviation) ** 2)

    sure, less = told(0.05), told(0.15)
    assert sure is not None
    assert less is not None
    variance = USUAL**2 + MISREAD**2
    assert sure == pytest.approx((0.5 - SKY_BESIDE) * USUAL**2 / (variance + 0.05**2), abs=0.01)
    assert less == pytest.approx((0.5 - SKY_BESIDE) * USUAL**2 / (variance + 0.15**2), abs=0.01)
    assert told(0.3) is None
    assert most_likely(np.zeros(len(FACTORS))) is None


@pytest.mark.parametrize("level", [-0.3, 0.3])
def test_the_light_is_as_bright_as_told(ball, level):
    problem, light = ball
    config = AppearanceConfig(iterations=160, parsimony_weight=0.0)
    wanted = level_of(problem, light) + level
    found = refit(problem, replace(light, level=wanted), config)
    assert level_of(problem, found) == pytest.approx(wanted, abs=0.03)
