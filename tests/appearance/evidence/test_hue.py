# SPDX-License-Identifier: Apache-2.0
"""A ball of two paints, whose light is known but for its hue."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from appearance import synthetic

from robir.appearance.config import AppearanceConfig
from robir.appearance.evidence.hue import both, told_hue
from robir.appearance.evidence.witness import Witness
from robir.appearance.light.problem import make_problem
from robir.appearance.light.solver import refit
from robir.appearance.light.told import NOTHING_TOLD, Told
from robir.appearance.material.gloss import estimate_gloss
from robir.maths.daylight import WHOLE
from robir.maths.tone import curve_from_name

RED = synthetic.Material(np.float32([0.45, 0.12, 0.1]), 0.45)
BLUE = synthetic.Material(np.float32([0.1, 0.25, 0.5]), 0.45)


@pytest.fixture(scope="module")
def ball():
    """The problem and its light."""
    light, curve = synthetic.sun_and_uneven_sky(), curve_from_name("filmic")
    halves = [(lambda at: at[:, 1] > 0, RED), (lambda at: at[:, 1] <= 0, BLUE)]
    return make_problem(synthetic.ball(halves, light, curve)[0], curve), light


def hue_of(problem, light):
    """Log hue (3,) of the mean irradiance from sky and suns."""
    rows = problem.scene.rows
    sent = (light.irradiance(problem, rows) - problem.indirect[rows]).mean(0).log()
    return (sent - sent.mean()).numpy()


@pytest.mark.parametrize("wrong", [np.log([0.75, 1.0, 1.25]), np.full(3, 0.3), np.zeros(3)])
def test_highlights_tell_the_hue(ball, wrong):
    problem, light = ball
    supposed = light.tinted(torch.from_numpy(wrong.astype(np.float32)))
    gloss, _ = estimate_gloss(problem, supposed, 2, 0)
    told, (balance, shine, together) = told_hue(problem, supposed, gloss, problem.scene.rows)
    assert told is not None
    np.testing.assert_allclose(told.numpy(), hue_of(problem, light), atol=0.04)
    red_over_blue = float(hue_of(problem, light) @ [1, 0, -1])
    assert shine.value == pytest.approx(red_over_blue, abs=0.06)
    assert 0 < shine.deviation < 0.06
    assert min(balance.value, shine.value) <= together.value <= max(balance.value, shine.value)
    assert together.deviation < shine.deviation


def test_two_witnesses_tell_what_their_product_does():
    at = np.linspace(-8, 8, 20001)
    pair = [Witness(of="hue", by="a", value=1.0, deviation=0.5)]
    pair.append(Witness(of="hue", by="b", value=-0.5, deviation=1.2))
    density = np.exp(sum(-0.5 * ((at - w.value) / w.deviation) ** 2 for w in pair))
    mean = (density * at).sum() / density.sum()
    deviation = np.sqrt((density * (at - mean) ** 2).sum() / density.sum())
    together = both(*pair)
    assert (together.value, together.deviation) == pytest.approx((mean, deviation), abs=1e-4)


def test_without_highlights_nothing_is_told(ball):
    problem, light = ball
    gloss, _ = estimate_gloss(problem, light, 2, 0)
    dull = replace(gloss, has_highlights=False)
    all_metal = replace(gloss, metallic=np.ones_like(gloss.metallic))
    for nothing in (
        told_hue(problem, light, other, problem.scene.rows) for other in (dull, all_metal)
    ):
        assert nothing[0] is None
        assert [witness.by for witness in nothing[1]] == ["white balance", "all"]


def test_the_light_follows_what_is_told(ball):
    problem, light = ball
    config = AppearanceConfig(iterations=160, parsimony_weight=0.0)
    told = np.float32([0.2, 0.0, -0.2])
    alone = refit(problem, light, NOTHING_TOLD, config)
    error = config.evidence.hue.error
    found = refit(problem, light, Told(hue=torch.from_numpy(told), hue_error=error), config)
    np.testing.assert_allclose(hue_of(problem, alone), 0, atol=0.03)
    # two normal distributions: of lights, and of what is told
    share = WHOLE.blue**2 / (WHOLE.blue**2 + 2 * error**2)
    np.testing.assert_allclose(hue_of(problem, found), share * told, atol=0.03)
