# SPDX-License-Identifier: Apache-2.0
"""A ball of two paints, whose light is known but for its brightness."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from appearance import synthetic

from robir.appearance.config import AppearanceConfig
from robir.appearance.evidence.level import (
    FACTORS,
    LIMIT,
    MISREAD,
    TOLD_DIM,
    USUAL,
    expected,
    level_by_highlights,
    misread,
    usual,
)
from robir.appearance.light.lobes import MEAN_ALBEDO, log_sent
from robir.appearance.light.problem import make_problem
from robir.appearance.light.solver import refit
from robir.appearance.material.gloss import estimate_gloss
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


@pytest.mark.parametrize("wrong", [-1.2, -0.4, 0.0, 0.4, 1.2])
def test_highlights_tell_the_brightness(ball, wrong):
    problem, light = ball
    supposed = light.tinted(torch.full((3,), wrong))
    gloss, _ = estimate_gloss(problem, supposed, 2, 0)
    told = level_by_highlights(problem, supposed, gloss, 0)
    assert told is not None
    assert told == pytest.approx(level_of(problem, light), abs=0.2)


def test_without_a_specular_layer_no_dimmer_light_is_told(ball):
    problem, light = ball
    for wrong in (-0.8, 0.8):
        supposed = light.tinted(torch.full((3,), wrong))
        gloss = replace(estimate_gloss(problem, supposed, 2, 0)[0], has_highlights=False)
        told = level_by_highlights(problem, supposed, gloss, 0)
        wanted = max(level_of(problem, light), level_of(problem, supposed))
        assert told == pytest.approx(wanted, abs=0.2)


def test_without_paint_no_brightness_is_told(ball):
    problem, light = ball
    gloss, _ = estimate_gloss(problem, light, 2, 0)
    all_metal = replace(gloss, metallic=np.ones_like(gloss.metallic))
    assert level_by_highlights(problem, light, all_metal, 0) is None


def test_without_evidence_paints_are_common_ones():
    shares = np.array([0.05, 0.1, MEAN_ALBEDO, 1.5])
    told = [expected(usual(np.log(np.full((1000, 3), share)))) for share in shares]
    assert (np.diff(told) > 0).all()
    assert told[0] < -1
    # what seems to return more than it receives bounds the light from below
    assert told[-1] > np.log(1.5) - LIMIT
    some = np.log(np.full((1000, 3), 0.05))
    some[:50] = 0.0
    assert expected(usual(some)) > -LIMIT


@pytest.mark.parametrize("deviation", [0.1, 0.5])
def test_the_less_highlights_say_the_less_is_changed(deviation):
    albedo = np.log(np.full((10, 3), MEAN_ALBEDO))
    told = -0.5 * ((FACTORS - 1.0) / deviation) ** 2
    # a product of Gaussians, and a dim light that makes paint too bright is out of question
    variance = MISREAD**2 + deviation**2
    wanted = (1.0 + TOLD_DIM) * USUAL**2 / (USUAL**2 + variance)
    assert expected(misread(told) + usual(albedo)) == pytest.approx(wanted, abs=0.03)


@pytest.mark.parametrize("level", [-0.3, 0.3])
def test_the_light_is_as_bright_as_told(ball, level):
    problem, light = ball
    config = AppearanceConfig(iterations=160, parsimony_weight=0.0)
    wanted = level_of(problem, light) + level
    found = refit(problem, replace(light, level=wanted), config)
    assert level_of(problem, found) == pytest.approx(wanted, abs=0.03)
