# SPDX-License-Identifier: Apache-2.0
"""A varnished ball in a room: windows that shading does not tell, and no sun.

What the cameras see is integrated over 2048 directions by the GGX lobe itself.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from appearance import synthetic

from robir.appearance.config import AppearanceConfig
from robir.appearance.light.lobes import Amplitudes, soft_lobes
from robir.appearance.light.problem import make_problem
from robir.appearance.light.solver import Light
from robir.appearance.material.gloss import estimate_gloss
from robir.appearance.material.roughness import ONE
from robir.appearance.model_size import REFLECTED, SHADED, with_reflected_sky
from robir.appearance.solution import solve
from robir.maths.tone import curve_from_name
from robir.steps import Course

ROUGHNESS = 0.3
BASE = np.array([0.3, 0.12, 0.1], np.float32)
NUM_LOBES = synthetic.NUM_SOFT
CONFIG = AppearanceConfig(num_soft_lobes=NUM_LOBES)
EVERYWHERE = lambda at: at[:, 0] < 9  # noqa: E731


def light_of(soft):
    return Light(
        axes=np.zeros((0, 3), np.float32),
        sharpness=np.zeros(0, np.float32),
        amplitudes=Amplitudes(soft=soft, sharp=torch.zeros(0, 3)),
        loss=0.0,
        history=(),
    )


def room():
    """Two windows, one of them bluish, in a dim room."""
    axes, _ = soft_lobes(NUM_LOBES)
    soft = torch.full((NUM_LOBES, 3), 0.1)
    soft[axes[:, 0] > 0.8] = torch.tensor([1.2, 1.2, 1.2])
    soft[axes[:, 1] > 0.85] = torch.tensor([0.5, 0.6, 0.8])
    return light_of(soft)


def problem_of(material):
    curve = curve_from_name("camera")
    scene, _ = synthetic.ball([(EVERYWHERE, material)], room(), curve)
    return make_problem(scene, curve)


@pytest.fixture(scope="module")
def varnished():
    return problem_of(synthetic.Material(BASE, ROUGHNESS))


def blurred(light):
    """The light with each lobe the mean of those about it: shading hardly changes."""
    axes, _ = soft_lobes(NUM_LOBES)
    weight = torch.exp(4.0 * (axes @ axes.T - 1))
    soft = weight @ light.amplitudes.soft / weight.sum(1, keepdim=True)
    return light_of(soft)


def gloss_of(problem, light):
    return estimate_gloss(problem, light, 2, 0)[0]


def told_of(problem, light):
    """Problem, light, roughness and choice that are proven."""
    told = with_reflected_sky(problem, light, gloss_of(problem, light), CONFIG)
    assert told is not None
    return told


def off(light):
    """Root mean square of what the lobes are wrong by."""
    return float((light.amplitudes.soft - room().amplitudes.soft).square().mean().sqrt())


def test_windows_come_back_and_the_roughness_with_them(varnished):
    _, light, roughness, choice = told_of(varnished, blurred(room()))
    assert choice.chosen == REFLECTED and roughness == ROUGHNESS
    assert off(light) < 0.5 * off(blurred(room()))
    # the sky of each part of the ball is told by the others
    assert choice.held_out_error is not None and choice.held_out_error < 6
    hue = (light.amplitudes.soft / light.amplitudes.soft.mean(1, keepdim=True)).log()
    axes, _ = soft_lobes(NUM_LOBES)
    assert float((hue[:, 2] - hue[:, 0])[axes[:, 1] > 0.85].mean()) > 0.2


def test_what_shading_has_right_is_kept(varnished):
    supposed = blurred(room())
    _, light, _, _ = told_of(varnished, supposed)
    rows = varnished.scene.rows
    ratio = light.irradiance(varnished, rows) / supposed.irradiance(varnished, rows)
    assert float(ratio.log().abs().mean()) < 0.15


def test_shading_that_is_wrong_is_not_kept(varnished):
    """An even sky is parted, and becomes as bright and as uneven as the room is."""
    even, scene = light_of(torch.full((1, 3), 0.3)), varnished.scene
    one = replace(varnished, scene=replace(scene, soft=np.pi * torch.ones(len(scene.soft), 1)))
    problem, light, _, choice = told_of(one, even)
    assert choice.chosen == REFLECTED and light.amplitudes.soft.shape == (NUM_LOBES, 3)
    true = room().irradiance(varnished, scene.rows).log()
    supposed, found = (
        float((model.irradiance(of, scene.rows).log() - true).abs().mean())
        for of, model in ((one, even), (problem, light))
    )
    assert found < 0.6 * supposed


def test_a_matt_ball_reflects_nothing():
    matt = problem_of(synthetic.Material(BASE, 0.5, specular=0.0))
    supposed = room()
    _, light, roughness, choice = told_of(matt, supposed)
    assert choice.chosen == SHADED and light is supposed and roughness is None


def test_too_few_blocks_tell_nothing(varnished):
    few = varnished.scene.rows[: CONFIG.evidence.reflected_sky.num_folds - 1]
    scarce = replace(varnished, scene=replace(varnished.scene, rows=few))
    gloss = gloss_of(varnished, room())
    assert with_reflected_sky(scarce, room(), gloss, CONFIG) is None


def test_the_solution_takes_sky_and_roughness(varnished):
    config = AppearanceConfig(num_soft_lobes=NUM_LOBES, iterations=90, num_materials=4)
    found = solve(varnished, blurred(room()), config, 0, Course())
    rows = {choice.choice: choice.chosen for choice in (*found.choices, *found.material.choices)}
    assert rows["sky in paint"] == REFLECTED and rows["roughness"] == ONE
    seen = varnished.radiance.seen.numpy()
    assert found.material.has_highlights
    # a level beside the true one at most, as the light's strength is not known either
    assert np.median(found.material.roughness[seen]) == pytest.approx(ROUGHNESS, abs=0.13)
    without = solve(varnished, blurred(room()), config, 0, Course(("reflected-sky",)))
    # one paint has one albedo, and the layer's F0 tells how bright it is
    errors = []
    for one in (found, without):
        albedo = one.matte.radiance.linear / one.light.irradiance(one.matte, np.arange(len(seen)))
        ratio = (np.pi * albedo)[seen].log()
        errors.append(float((ratio - ratio.mean(0)).std()))
        if one is found:
            assert (np.pi * albedo)[seen].median(0).values.numpy() == pytest.approx(BASE, rel=0.15)
    assert errors[0] < 0.3 * errors[1]
