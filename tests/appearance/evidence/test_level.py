# SPDX-License-Identifier: Apache-2.0
"""A ball of two paints, whose light is known but for its brightness."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from appearance import synthetic

from robir.appearance.config import AppearanceConfig
from robir.appearance.evidence import (
    _EXCESS,
    _EXPOSURE,
    _LOG_ALBEDO,
    albedo_prior,
    exposure_prior,
    level_estimates,
    log_factors,
)
from robir.appearance.light.lobes import LightPrior, log_sent
from robir.appearance.light.problem import make_problem
from robir.appearance.light.solver import refit
from robir.appearance.material.specular import estimate_specular
from robir.maths.tone import curve_from_name

CONFIG = AppearanceConfig()
FACTORS = log_factors()
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


def witnesses_of(problem, light, specular):
    """What each tells, by its name."""
    return {told.by: told for told in level_estimates(problem, light, specular, problem.scene.rows)}


def test_what_both_tell_is_the_same_wherever_one_starts(ball):
    problem, light = ball
    told = []
    for wrong in (-0.8, 0.0, 0.8):
        supposed = light.tinted(torch.full((3,), wrong))
        specular, _ = estimate_specular(problem, supposed, 2, 0)
        told.append(witnesses_of(problem, supposed, specular)["all"].value)
    assert np.ptp(told) < 0.1


def test_without_paint_no_brightness_is_told(ball):
    problem, light = ball
    specular, _ = estimate_specular(problem, light, 2, 0)
    all_metal = replace(specular, metallic=np.ones_like(specular.metallic))
    assert level_estimates(problem, light, all_metal, problem.scene.rows) == ()


def mean_of(log_likelihood):
    """Mean log factor."""
    likely = np.exp(log_likelihood - log_likelihood.max())
    return float(likely @ FACTORS / likely.sum())


def test_without_other_evidence_paints_are_common_ones():
    common = np.exp(_LOG_ALBEDO)
    shares = np.array([0.6 * common, common, 3 * common])
    told = [mean_of(albedo_prior(np.log(np.full((1000, 3), share)))) for share in shares]
    assert told == pytest.approx(np.log(shares / common), abs=0.03)
    # what seems to return more than it receives bounds the light from below
    some = np.log(np.full((1000, 3), common))
    some[:50] = 1.0
    assert mean_of(albedo_prior(some)) > 1.0 - 2 * _EXCESS


def test_without_other_evidence_white_paint_is_exposed_as_is_common():
    for white in (-1.0, 0.5):
        told = mean_of(exposure_prior(np.log(np.pi) + _EXPOSURE + white))
        assert told == pytest.approx(-white, abs=0.03)


@pytest.mark.parametrize("level", [-0.3, 0.3])
def test_the_light_is_as_bright_as_told(ball, level):
    problem, light = ball
    config = AppearanceConfig(iterations=160)
    wanted = level_of(problem, light) + level
    found = refit(problem, light, LightPrior(level=wanted, level_error=0.1), config)
    assert level_of(problem, found) == pytest.approx(wanted, abs=0.03)
