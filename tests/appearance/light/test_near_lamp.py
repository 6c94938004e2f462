# SPDX-License-Identifier: Apache-2.0
"""A lamp that stands near is told from a sun, its place is found, and a sun stays a sun."""

from __future__ import annotations

import numpy as np
import pytest
from appearance import synthetic

from robir.appearance.light import near_lamp
from robir.appearance.light.near_lamp import with_near_lamp
from robir.appearance.light.problem import make_problem
from robir.appearance.light.solver import fit
from robir.maths.tone import curve_from_name
from robir.transport.visibility import lobe_transfer

DISTANCE, FAR, SKY, LAMP = 4.0, 16.0, 0.12, 2.4
UP = np.float32([[0, 0, 1]])
STEPS = 80


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


def found(stage, received):
    """The scene's distance and the light, begun from a sun a little off."""
    curve = curve_from_name("filmic")
    irradiance = synthetic.direct(stage, 0.0, SKY) + LAMP * received[:, None] * synthetic.WARM
    problem = make_problem(synthetic.lit(stage, irradiance, curve), curve)
    axis = synthetic.SUN + np.float32([0.06, 0.0, 0.0])
    axis /= np.linalg.norm(axis)
    sharpness = np.float32([synthetic.SUN_SHARPNESS])
    start = fit(problem, axis[None], sharpness, STEPS)
    near, light = with_near_lamp(problem, start, STEPS)
    return near.scene.lamp_distance, light, start


def test_a_lamp_is_found_where_it_stands(stage):
    distance, light, start = found(stage, lamp_at(stage, DISTANCE))
    assert DISTANCE / 1.3 < distance < DISTANCE * 1.3
    assert np.degrees(np.arccos(float(light.axes[0] @ synthetic.SUN))) < 3.0
    assert light.loss < 0.9 * start.loss


def test_a_sun_stays_infinitely_far(stage):
    distance, light, start = found(stage, synthetic.sun_transfer(stage))
    assert np.isinf(distance)
    assert light is start


def test_a_lamp_so_far_that_it_hardly_differs_from_a_sun_stays_one(stage):
    distance, *_ = found(stage, lamp_at(stage, FAR))
    assert np.isinf(distance)


def test_a_lamp_must_explain_enough(stage, monkeypatch):
    monkeypatch.setattr(near_lamp, "_LEAST_GAIN", 0.99)
    distance, light, start = found(stage, lamp_at(stage, DISTANCE))
    assert np.isinf(distance)
    assert light is start


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
