# SPDX-License-Identifier: Apache-2.0
"""A ball of two paints, whose light is known but for its hue and strength."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from appearance import synthetic

from robir.appearance.config import AppearanceConfig
from robir.appearance.gloss import estimate_gloss
from robir.appearance.light import HUE_TRUST
from robir.appearance.light_level import level_by_highlights
from robir.appearance.problem import make_problem
from robir.appearance.solver import refit
from robir.maths.tone import curve_from_name

RED = synthetic.Material(np.float32([0.45, 0.12, 0.1]), 0.45)
BLUE = synthetic.Material(np.float32([0.1, 0.25, 0.5]), 0.45)
WRONG = np.float32([0.75, 1.0, 1.25])


@pytest.fixture(scope="module")
def ball():
    """The problem and its light."""
    light, curve = synthetic.sun_and_uneven_sky(), curve_from_name("filmic")
    halves = [(lambda at: at[:, 1] > 0, RED), (lambda at: at[:, 1] <= 0, BLUE)]
    return make_problem(synthetic.ball(halves, light, curve)[0], curve), light


def scaled(light, factor):
    """The light with each channel brighter by a factor (3,)."""
    strengths = light.amplitudes
    factor = torch.from_numpy(factor)
    return replace(
        light,
        amplitudes=replace(strengths, soft=strengths.soft * factor, sharp=strengths.sharp * factor),
    )


def level_of(problem, light):
    """Log (3,) of the mean irradiance from sky and suns."""
    rows = problem.scene.rows
    return (light.irradiance(problem, rows) - problem.indirect[rows]).mean(0).log().numpy()


@pytest.mark.parametrize("wrong", [WRONG, np.float32([1.4, 1.4, 1.4]), np.ones(3, np.float32)])
def test_highlights_tell_hue_and_strength(ball, wrong):
    problem, light = ball
    supposed = scaled(light, wrong)
    gloss, _ = estimate_gloss(problem, supposed, 2, 0)
    told = level_by_highlights(problem, supposed, gloss)
    assert told is not None
    apart = told.numpy() - level_of(problem, light)
    np.testing.assert_allclose(apart - apart.mean(), 0, atol=0.04)
    # a light supposed too strong is taken for rougher paint, a third of the way
    assert abs(apart.mean()) < 0.06 + 0.4 * abs(np.log(wrong).mean())


def test_without_highlights_nothing_is_told(ball):
    problem, light = ball
    gloss, _ = estimate_gloss(problem, light, 2, 0)
    assert level_by_highlights(problem, light, replace(gloss, has_highlights=False)) is None
    all_metal = replace(gloss, metallic=np.ones_like(gloss.metallic))
    assert level_by_highlights(problem, light, all_metal) is None


def test_the_light_follows_what_is_told(ball):
    problem, light = ball
    config = AppearanceConfig(iterations=160, parsimony_weight=0.0)
    alone = level_of(problem, refit(problem, light, config))
    told = alone.mean() + np.float32([0.5, 0.3, 0.1])
    found = level_of(problem, refit(problem, replace(light, told=torch.from_numpy(told)), config))
    hue, told_hue = found - found.mean(), told - told.mean()
    np.testing.assert_allclose(alone - alone.mean(), 0, atol=0.03)
    np.testing.assert_allclose(hue, HUE_TRUST * told_hue, atol=0.03)
    assert 0.03 < found.mean() - alone.mean() < 0.2
