# SPDX-License-Identifier: Apache-2.0
"""Re-toned photographs are told from others, and ordinary ones are left alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from appearance import synthetic

from robir.appearance.tone import display_power
from robir.appearance.tone.display_power import USUAL_LEVEL, choose_power, leading_power
from robir.maths.tone import curve_from_name

SUN, SKY = 2.5, 0.12
BRIGHT, DARK = USUAL_LEVEL[1] + 0.1, USUAL_LEVEL[0] - 0.1


@pytest.fixture(scope="module")
def scene():
    return synthetic.scene_of(
        synthetic.boxes_on_a_floor(1000), SUN, SKY, curve_from_name("standard"), 700
    )


def retoned(scene, power):
    seen = scene.transport.observations
    codes = np.rint(255 * (seen.display / 255) ** power).astype(np.uint8)
    seen = replace(seen, display=codes)
    return replace(scene, transport=replace(scene.transport, observations=seen))


@pytest.mark.parametrize("power", [0.5, 2.0])
def test_the_power_of_retoned_photographs_is_found(scene, power):
    curve, light = curve_from_name("standard"), synthetic.true_light(SUN, SKY)
    choice = choose_power(retoned(scene, power), (curve,), light, 0)
    assert choice.power == power
    assert np.argmax(choice.votes) == display_power.POWERS.index(power)


def test_ordinary_photographs_are_not_even_asked(scene, monkeypatch):
    monkeypatch.setattr(display_power, "fit", None)
    curve, light = curve_from_name("standard"), synthetic.true_light(SUN, SKY)
    choice = choose_power(scene, (curve,), light, 0)
    assert USUAL_LEVEL[0] < choice.level < USUAL_LEVEL[1]
    assert (choice.power, choice.votes) == (1.0, ())


def test_what_another_curve_explains_is_no_power():
    """Dim photographs by a camera's response, darker than the sRGB curve makes them."""
    curves = [curve_from_name(name) for name in ("standard", "camera")]
    stage = synthetic.boxes_on_a_floor(1000)
    dim = synthetic.scene_of(stage, 0.3 * SUN, 0.3 * SKY, curves[1], 700)
    light = synthetic.true_light(SUN, SKY)
    choice = choose_power(dim, curves, light, 0)
    assert choice.level < USUAL_LEVEL[0]
    assert choice.power == 1.0
    alone = choose_power(dim, curves[:1], light, 0)
    assert choice.votes[1] > alone.votes[1]


def votes(mean, noise, count=400):
    rng = np.random.default_rng(0)
    return mean + noise * rng.standard_normal(count), np.ones(count)


@pytest.mark.parametrize(
    ("low", "one", "high", "level", "expected"),
    [
        (0.30, 0.25, 0.20, BRIGHT, 0.5),
        (0.20, 0.25, 0.30, DARK, 2.0),
        # what leads is not what the level asks for
        (0.20, 0.25, 0.30, BRIGHT, 1.0),
        (0.30, 0.25, 0.20, DARK, 1.0),
        # no lead over 1, or none over the reciprocal
        (0.25, 0.25, 0.20, BRIGHT, 1.0),
        (0.30, 0.25, 0.30, BRIGHT, 1.0),
    ],
)
def test_a_power_must_lead_one_and_its_reciprocal(low, one, high, level, expected):
    rng = np.random.default_rng(0)
    tables = [(mean + 0.02 * rng.standard_normal(400), np.ones(400)) for mean in (low, one, high)]
    assert leading_power(tables, level) == expected


def test_a_lead_within_the_noise_is_none():
    rng = np.random.default_rng(3)
    tables = [(mean + 5.0 * rng.standard_normal(400), np.ones(400)) for mean in (0.30, 0.25, 0.2)]
    assert leading_power(tables, BRIGHT) == 1.0
