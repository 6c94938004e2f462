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
from robir.appearance.light_level import HUE_TRUST, STRENGTH_TRUST, level_by_highlights
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


@pytest.mark.parametrize("wrong", [WRONG, np.float32([1.6, 1.6, 1.6]), np.ones(3, np.float32)])
def test_highlights_tell_hue_and_strength(ball, wrong):
    problem, light = ball
    tinted = scaled(light, wrong)
    gloss, _ = estimate_gloss(problem, tinted, 2, 0)
    found = level_by_highlights(problem, tinted, gloss)
    moved = np.log((found.amplitudes.sharp / tinted.amplitudes.sharp).numpy()[0])
    wanted = -np.log(wrong)
    hue = wanted - wanted.mean()
    np.testing.assert_allclose(moved - moved.mean(), HUE_TRUST * hue, atol=0.03)
    assert moved.mean() == pytest.approx(STRENGTH_TRUST * wanted.mean(), abs=0.07)
    # the sky with the sun
    ratio = (found.amplitudes.soft / tinted.amplitudes.soft).numpy()
    np.testing.assert_allclose(np.log(ratio), np.broadcast_to(moved, ratio.shape), atol=1e-5)


def test_without_highlights_the_light_is_left(ball):
    problem, light = ball
    gloss, _ = estimate_gloss(problem, light, 2, 0)
    for told in (
        replace(gloss, has_highlights=False),
        replace(gloss, metallic=1 + 0 * gloss.metallic),
    ):
        found = level_by_highlights(problem, light, told)
        torch.testing.assert_close(found.amplitudes.sharp, light.amplitudes.sharp)


@pytest.mark.parametrize("keeps_level", [True, False])
def test_a_level_that_is_known_stays(ball, keeps_level):
    problem, light = ball
    tinted = scaled(light, np.float32([1.6, 1.2, 1.0]))
    rows = problem.scene.rows

    def level(light):
        return np.log((light.irradiance(problem, rows) - problem.indirect[rows]).mean(0).numpy())

    config = AppearanceConfig(iterations=120, parsimony_weight=0.0)
    found = refit(problem, tinted, config, keeps_level)
    moved = np.abs(level(found) - level(tinted)).max()
    assert (moved < 0.03) == keeps_level
