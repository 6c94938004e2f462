# SPDX-License-Identifier: Apache-2.0
"""A room's light is told from a sky's, its lamp is found, and what is far stays far."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from appearance import synthetic

from robir.appearance.config import AppearanceConfig
from robir.appearance.light import distance as light_distance
from robir.appearance.light.distance import with_distance
from robir.appearance.light.lobes import soft_lobes, soft_transfer
from robir.appearance.light.problem import make_problem
from robir.appearance.light.solver import fit
from robir.appearance.light.sun_search import polish
from robir.maths.tone import curve_from_name
from robir.transport.surfels import Surfels
from robir.transport.visibility import Visibility, lobe_transfer

NEAR, FAR, SKY, LAMP = 4.0, 24.0, 0.12, 2.4
UP = np.float32([[0, 0, 1]])
CONFIG = AppearanceConfig(num_soft_lobes=synthetic.NUM_SOFT, num_scan_directions=500)


@pytest.fixture(scope="module")
def stage():
    return synthetic.boxes_on_a_floor()


def lamp_at(stage, distance):
    """Irradiance (S,) of a lamp at a point, for 1 at the origin: Lambert and the inverse square."""
    position, normal = stage.surfels.position, stage.surfels.normal
    aside = distance * synthetic.SUN - position
    length = np.linalg.norm(aside, axis=1)
    ray = (aside / length[:, None]).astype(np.float32)
    cosine = (ray * normal).sum(1).clip(0)
    start = position + synthetic.OFFSET * normal
    free = ~stage.tracer.is_blocked(start.astype(np.float32), ray)
    return np.where(free, cosine, 0) * (distance / length) ** 2


def given(stage, received, **facts):
    """The problem of what is received, and its best light from afar, begun a little off."""
    curve = curve_from_name("filmic")
    irradiance = synthetic.direct(stage, 0.0, SKY) + LAMP * received[:, None] * synthetic.WARM
    scene = replace(synthetic.lit(stage, irradiance, curve), **facts)
    axis = synthetic.SUN + np.float32([0.06, 0.0, 0.0])
    axis /= np.linalg.norm(axis)
    problem = make_problem(scene, curve)
    first = fit(problem, axis[None], np.float32([synthetic.SUN_SHARPNESS]), 80)
    return problem, polish(problem, first, CONFIG, 0)


def test_a_lamp_is_found_where_it_stands(stage):
    near, light, afar = with_distance(*given(stage, lamp_at(stage, NEAR)), CONFIG, 0)
    assert NEAR / 1.5 < near.scene.light_distance < NEAR * 1.5
    assert np.degrees(np.arccos(float(light.axes[0] @ synthetic.SUN))) < 3.0
    assert light.loss < 0.9 * afar
    rows = near.scene.rows
    share = light.irradiance(near, rows).numpy()[:, 1]
    true = synthetic.direct(stage, 0.0, SKY) + LAMP * lamp_at(stage, NEAR)[:, None] * synthetic.WARM
    off = np.log(share / (true[rows, 1] + near.indirect[rows, 1].numpy()))
    assert np.std(off) < 0.2


@pytest.mark.parametrize("distance", [np.inf, FAR])
def test_what_is_far_stays_infinitely_far(stage, distance):
    is_sun = np.isinf(distance)
    received = synthetic.sun_transfer(stage) if is_sun else lamp_at(stage, distance)
    problem, light = given(stage, received)
    same, kept, afar = with_distance(problem, light, CONFIG, 0)
    assert same is problem
    assert kept.loss == afar
    np.testing.assert_array_equal(kept.axes, light.axes)


def test_a_near_light_must_explain_enough(stage, monkeypatch):
    monkeypatch.setattr(light_distance, "_LEAST_GAIN", 0.99)
    problem, light = given(stage, lamp_at(stage, NEAR))
    assert with_distance(problem, light, CONFIG, 0)[0] is problem


def test_a_sun_that_the_user_knows_is_no_lamp(stage):
    problem, light = given(stage, lamp_at(stage, NEAR), sun=synthetic.SUN)
    assert with_distance(problem, light, CONFIG, 0)[0] is problem


@pytest.mark.parametrize("distance", [1.5, 4.0, np.inf])
def test_soft_lobes_shine_from_a_sphere(distance):
    """Against radiance added up over the sphere's area, which falls off by the square."""
    rng = np.random.default_rng(1)
    position = np.float32([[0.5, -0.3, 0.4], [0.0, 0.0, 0.0]])
    normal = np.float32([[0.36, 0.48, 0.8], [0.0, 0.6, -0.8]])
    directions = rng.normal(size=(60_000, 3)).astype(np.float32)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    above = normal @ directions.T > 0
    visibility = Visibility(
        directions=directions, bits=np.packbits(above, axis=1), bounce=None, is_traced=False,
        offset=0.0,
    )  # fmt: skip
    surfels = Surfels(position=position, normal=normal, spacing=0.1)
    found = soft_transfer(visibility, surfels, 8, distance).numpy()
    axes, sharpness = soft_lobes(8)
    draws = torch.randn(400_000, 3, generator=torch.Generator().manual_seed(2)).double()
    ball = draws / draws.norm(dim=1, keepdim=True)
    radius = 1e5 if np.isinf(distance) else distance
    radiance = torch.exp(sharpness * (ball @ axes.double().T - 1))
    for row in range(2):
        aside = radius * ball - torch.from_numpy(position[row]).double()
        length = aside.norm(dim=1)
        ray = aside / length[:, None]
        cosine = (ray @ torch.from_numpy(normal[row]).double()).clamp(min=0)
        # cosine at the sphere, whose inside shines
        weight = cosine * (ray * ball).sum(1) * (radius / length) ** 2 * 4 * np.pi
        values = weight[:, None] * radiance
        expected, error = values.mean(0), values.std(0) / len(ball) ** 0.5
        directly = np.maximum(normal[row] @ directions.T, 0) * 4 * np.pi
        own_error = directly.std() / len(directions) ** 0.5
        assert (np.abs(found[row] - expected.numpy()) < 4 * (error.numpy() + own_error)).all()


def test_a_near_lamp_shines_by_the_inverse_square_and_one_from_afar_as_a_sun():
    rng = np.random.default_rng(0)
    position = rng.uniform(-1, 1, (200, 3)).astype(np.float32)
    normal = np.repeat(UP, 200, 0)
    axis = np.float32([[0.6, 0.0, 0.8]])
    aside = 3.0 * axis - position
    squared = (aside**2).sum(1)
    expected = (aside[:, 2] / np.sqrt(squared)).clip(0) * 9.0 / squared
    near = lobe_transfer(None, position, normal, axis, 0.0, 3.0)
    assert near == pytest.approx(expected, rel=1e-4)
    sun = lobe_transfer(None, position, normal, axis, 0.0)
    assert lobe_transfer(None, position, normal, axis, 0.0, 1e5) == pytest.approx(sun, rel=1e-3)
