# SPDX-License-Identifier: Apache-2.0
"""What counts as proof, and what only looks like one."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from appearance import synthetic

from robir.appearance.held_out_test import EVERY, HeldOutTest
from robir.appearance.light.problem import make_problem
from robir.appearance.material.observed import looked_at
from robir.appearance.material.trial import MaterialTrial
from robir.appearance.photometry.statistics import display_mean
from robir.maths.tone import curve_from_name

PAINT = synthetic.Material(np.float32([0.4, 0.3, 0.2]), 0.9, specular=0.0)
GLOSS = synthetic.Material(np.float32([0.12, 0.3, 0.35]), 0.4)


def test_of_two_means_the_error_is_that_of_their_difference():
    """Views differ by ten times the gain, but both models err alike in each."""
    view = np.repeat(np.arange(10), 5)
    plain = 1.0 + view
    test = HeldOutTest.of(plain, plain - 0.1, (view,))
    assert test.gain == pytest.approx(0.1)
    assert test.error == pytest.approx(0, abs=1e-12)
    assert test.is_passed
    assert test.plain == pytest.approx(255 * 5.5**0.5)


def test_a_gain_of_chance_is_no_proof():
    rng = np.random.default_rng(0)
    view = np.repeat(np.arange(12), 200)
    given = [
        HeldOutTest.of(0 * view + 9.0, 9 + rng.standard_normal(12)[view], (view,)).is_passed
        for _ in range(400)
    ]
    # one normal deviate in six exceeds one standard error
    assert np.mean(given) == pytest.approx(0.17, abs=0.05)


def test_one_view_and_one_place_prove_nothing():
    ones = np.ones(50)
    several = np.arange(50) % 5
    assert not HeldOutTest.of(ones, 0 * ones, (np.zeros(50, int),)).is_passed
    assert not HeldOutTest.of(ones, 0 * ones, (several, np.zeros(50, int))).is_passed
    assert HeldOutTest.of(ones, 0 * ones, (several, several)).is_passed
    assert not HeldOutTest.of(ones[:0], ones[:0], (several[:0],)).is_passed


@pytest.mark.parametrize("family", ["standard", "filmic", "agx"])
def test_the_display_mean_is_nearest_to_the_photographs(family):
    curve = curve_from_name(family)
    generator = torch.Generator().manual_seed(0)
    linear = 0.05 + 0.5 * torch.rand(20, 9, 3, generator=generator)
    weight = torch.rand(20, 9, generator=generator)
    weight[:, 4] = 0
    linear[:, 4] = 9.0

    def error(radiance):
        off = curve.display_from_linear(linear) - curve.display_from_linear(radiance)[:, None]
        return ((off**2).sum(2) * weight).sum(1)

    mean = display_mean(linear, weight, curve)
    least = error(mean)
    for factor in (0.97, 1.03):
        assert (error(factor * mean) > least).all()


@pytest.fixture(scope="module")
def trials():
    """Paint without a specular layer, and paint with one: problem, trial and samples."""
    light, curve = synthetic.sun_and_uneven_sky(), curve_from_name("standard")
    found = []
    for material in (PAINT, GLOSS):
        scene, _ = synthetic.ball([(lambda at: at[:, 1] < 99, material)], light, curve)
        problem = make_problem(scene, curve)
        rows = np.flatnonzero(problem.radiance.seen.numpy())
        reflections, rays, seen, _ = looked_at(problem, light, rows)
        trial = MaterialTrial(reflections=reflections, rays=rays, seen=seen)
        found.append((trial, len(rows)))
    return found


def test_a_specular_layer_is_proven_where_there_is_one(trials):
    for (trial, count), is_glossy in zip(trials, (False, True), strict=True):
        rays = trial.rays_of(np.ones(count, bool))
        level = np.full(count, GLOSS.roughness)
        test = trial.compare(
            rays, trial.dielectric_errors(rays, None), trial.dielectric_errors(rays, level)
        )
        assert test.is_passed == is_glossy
        assert test.leads_by(-1.0) == is_glossy


def test_no_view_takes_part_in_its_own_prediction(trials):
    """Nor do the others of its fold: changed photographs change no prediction of themselves."""
    trial, count = trials[0]
    rays = trial.rays_of(np.arange(count) == 5)
    seen = trial.seen.of(rays)
    fold = trial.rays.of(rays).view % EVERY
    before = trial.dielectric_errors(rays, None)
    linear = seen.linear.clone()
    linear[torch.from_numpy(fold == fold[0])] *= 1.5
    trial.seen.linear[rays] = linear
    after = trial.dielectric_errors(rays, None)
    trial.seen.linear[rays] = seen.linear
    np.testing.assert_allclose(after[fold == fold[0]], before[fold == fold[0]], atol=1e-9)
    assert (np.abs(after - before) > 1e-6)[fold != fold[0]].all()
