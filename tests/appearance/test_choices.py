# SPDX-License-Identifier: Apache-2.0
"""Scenes for which it is known how large the model has to be: what the stage chooses for each."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from appearance import synthetic

from robir.appearance.config import AppearanceConfig
from robir.appearance.light.lobes import soft_lobes
from robir.appearance.light.problem import make_problem
from robir.appearance.material.roughness import EACH, ONE, USUAL, WITH_SPECULAR, WITHOUT_SPECULAR
from robir.appearance.material.specular import specular_towards
from robir.appearance.solution import solve
from robir.appearance.tone.choose import choose_tone_curve
from robir.maths.tone import curve_from_name
from robir.steps import Pipeline

CONFIG = AppearanceConfig(
    num_soft_lobes=synthetic.NUM_SOFT, num_scan_directions=600, iterations=90, num_materials=4
)
GIVEN = replace(CONFIG, families=("filmic",))  # for what does not ask for the curve
OVERCAST = np.float32([0.9, 0.97, 1.0])
CLAY, SLATE = np.float32([0.5, 0.3, 0.2]), np.float32([0.15, 0.3, 0.5])


def chosen(scene, config=GIVEN):
    """The model of a scene, its rows by name, its light, and its gloss."""
    tone = choose_tone_curve(scene, config, 0, Pipeline())
    first = tone.candidates[0]
    found = solve(first.problem, first.light, config, 0, Pipeline())
    specular = found.material
    rows = {row.choice: row.chosen for row in (*found.choices, *specular.choices)}
    return first.curve.name, rows, found.light, specular


def seen_samples(scene):
    return (scene.transport.observations.weight > 0).sum(1) >= 2


def halves(first, second):
    return [(lambda at: at[:, 1] > 0, first), (lambda at: at[:, 1] <= 0, second)]


def under_a_sky(weight_of_axes):
    """Boxes under lobes of these weights, and no sun."""
    stage, curve = synthetic.boxes_on_a_floor(), curve_from_name("filmic")
    visibility = stage.visibility
    axes, sharpness = soft_lobes(synthetic.NUM_SOFT)
    lobes = np.exp(sharpness * (visibility.directions @ axes.numpy().T - 1))
    cosine = (stage.surfels.normal @ visibility.directions.T).clip(0)
    weight = visibility.unpacked() * cosine * (4 * np.pi / len(visibility.directions))
    irradiance = (weight @ lobes @ weight_of_axes(axes.numpy()))[:, None] * (0.15 * OVERCAST)
    return stage, synthetic.lit(stage, irradiance, curve)


def test_a_flat_sky_is_flat_and_has_no_sun():
    _, scene = under_a_sky(lambda axes: np.ones(len(axes)))
    _, _, light, _ = chosen(scene)
    assert light.axes.shape == (0, 3)
    # the boxes stand on a floor, which hides what lies below
    axes, _ = soft_lobes(synthetic.NUM_SOFT)
    above = light.amplitudes.soft[axes[:, 2] > 0.2].log()
    assert float(above.std(0).max()) < 0.1


def test_shading_tells_sun_and_curve_and_highlights_one_roughness():
    """Two paints under one varnish on an isolated convex object."""
    parts = halves(synthetic.Material(CLAY, 0.56), synthetic.Material(SLATE, 0.56))
    scene, _ = synthetic.ball(parts, synthetic.sun_and_uneven_sky(), curve_from_name("filmic"))
    name, rows, light, specular = chosen(scene, CONFIG)
    assert name == "filmic"
    assert float(light.axes[0] @ np.float32([0.6, 0.0, 0.8])) > np.cos(np.radians(5))
    assert (rows["specular"], rows["roughness"]) == (WITH_SPECULAR, ONE)
    seen = seen_samples(scene)
    assert len(set(specular.roughness[seen])) == 1
    assert specular.roughness[seen][0] == pytest.approx(0.56, abs=0.08)
    assert not specular.metallic.any()


def test_a_polished_half_and_a_rough_one_have_each_its_roughness():
    polished, rough = synthetic.Material(CLAY, 0.3), synthetic.Material(SLATE, 0.72)
    parts = halves(polished, rough)
    scene, _ = synthetic.ball(parts, synthetic.sun_and_uneven_sky(), curve_from_name("filmic"))
    # of more materials none is mirrored by enough of so few views
    _, rows, _, specular = chosen(scene, replace(GIVEN, num_materials=2))
    assert (rows["specular"], rows["roughness"]) == (WITH_SPECULAR, EACH)
    seen = seen_samples(scene)
    is_polished = scene.transport.surfels.position[:, 1] > 0
    assert np.median(specular.roughness[seen & is_polished]) == pytest.approx(0.3, abs=0.1)
    assert np.median(specular.roughness[seen & ~is_polished]) == pytest.approx(0.72, abs=0.1)


def test_a_matte_object_has_no_highlights():
    """Lambert's paint without any varnish: nothing in it is glossy, nothing is taken off it."""
    parts = halves(*(synthetic.Material(base, 0.5, specular=0.0) for base in (CLAY, SLATE)))
    scene, _ = synthetic.ball(parts, synthetic.sun_and_uneven_sky(), curve_from_name("filmic"))
    _, rows, light, specular = chosen(scene)
    assert (rows["specular"], rows["roughness"]) == (WITHOUT_SPECULAR, ONE)
    seen = seen_samples(scene)
    assert not specular.has_highlights
    assert not specular.metallic.any()
    assert not specular.floor.any()
    np.testing.assert_array_equal(specular.kept, 1)
    np.testing.assert_array_equal(specular.roughness[seen], USUAL)
    problem = make_problem(scene, curve_from_name("filmic"))
    few = np.flatnonzero(seen)[:5]
    towards = scene.transport.surfels.normal[few]
    dielectric, _, kept = specular_towards(problem, light, specular, few, towards)
    np.testing.assert_array_equal(dielectric, 0)
    np.testing.assert_array_equal(kept, 1)


def test_gold_is_metal_and_nothing_else():
    gold = synthetic.Material(np.float32([0.9, 0.62, 0.25]), 0.3, specular=1.0)
    parts = [(lambda at: at[:, 0] < 2, gold)]
    scene, _ = synthetic.ball(parts, synthetic.sun_and_uneven_sky(), curve_from_name("filmic"))
    specular = chosen(scene)[3]
    seen = seen_samples(scene)
    assert specular.metallic[seen].mean() > 0.95
    red, green, blue = np.median(specular.metal[seen], 0)
    # what is read is drawn towards what metals there are
    assert red > 1.1 * green > 1.1**2 * blue
