# SPDX-License-Identifier: Apache-2.0
"""A ball, half rough plastic and half metal, rendered by quadrature of the reflection integral."""

from __future__ import annotations

import numpy as np
import pytest
from appearance import synthetic

from robir.appearance.light.problem import make_problem
from robir.appearance.material.specular import estimate_specular
from robir.appearance.photometry.statistics import texture_weights
from robir.maths.tone import curve_from_name

GOLD = synthetic.Material(np.float32([0.9, 0.62, 0.25]), 0.3, specular=1.0)
PLASTIC = synthetic.Material(np.float32([0.12, 0.3, 0.35]), 0.56)
LACQUER = synthetic.Material(np.float32([0.07, 0.012, 0.015]), 0.15)
# half the width of a strip of metal, unit frame; neighbourhoods reach about twice as far
STRIP = 0.12


@pytest.fixture(scope="module")
def ball():
    """The problem, its light, which samples are gold, and the radiance of every observation."""
    light, curve = synthetic.sun_and_uneven_sky(), curve_from_name("filmic")
    halves = [(lambda at: at[:, 1] > 0, GOLD), (lambda at: at[:, 1] <= 0, PLASTIC)]
    scene, radiance = synthetic.ball(halves, light, curve)
    is_gold = scene.transport.surfels.position[:, 1] > 0
    return make_problem(scene, curve), light, is_gold, radiance


def test_metal_and_plastic_are_told_apart(ball):
    problem, light, is_gold, radiance = ball
    specular, diffuse = estimate_specular(problem, light, 4, 0)
    seen = problem.radiance.seen.numpy()
    metallic = specular.metallic > 0.5
    # along the border neighbours of both kinds judge together
    assert (metallic == is_gold)[seen].mean() > 0.95
    assert np.median(specular.roughness[seen & is_gold]) == pytest.approx(GOLD.roughness, abs=0.08)
    np.testing.assert_allclose(np.median(specular.metal[seen & is_gold], 0), GOLD.base, atol=0.1)
    plastic = seen & ~is_gold
    assert np.median(specular.roughness[plastic]) == pytest.approx(PLASTIC.roughness, abs=0.08)
    # What is left of plastic without its highlights is Lambert's share, the same from everywhere.
    left = diffuse.numpy()[plastic]
    weight = problem.scene.transport.observations.weight[plastic] > 0
    share = np.where(weight[..., None], left, np.nan)
    spread = np.nanstd(share, axis=1) / np.nanmean(share, axis=1)
    whole = np.where(weight[..., None], radiance[plastic], np.nan)
    before = np.nanstd(whole, axis=1) / np.nanmean(whole, axis=1)
    assert np.nanmedian(spread) < 0.25 * np.nanmedian(before)
    assert sum(row["share"] for row in specular.table) == pytest.approx(1)


def test_a_strip_of_metal_narrower_than_its_neighbourhoods_is_found():
    light, curve = synthetic.sun_and_uneven_sky(), curve_from_name("filmic")
    inside = [
        (lambda at: abs(at[:, 1]) < STRIP, GOLD),
        (lambda at: abs(at[:, 1]) >= STRIP, PLASTIC),
    ]
    scene, _ = synthetic.ball(inside, light, curve, 2000)
    is_gold = abs(scene.transport.surfels.position[:, 1]) < STRIP
    problem = make_problem(scene, curve)
    metallic = estimate_specular(problem, light, 4, 0)[0].metallic > 0.5
    seen = problem.radiance.seen.numpy()
    # where hardly any light is mirrored nothing tells metal; by place alone half is found
    assert metallic[seen & is_gold].mean() > 0.6
    assert metallic[seen & ~is_gold].mean() < 0.02


def test_glossy_paint_that_touches_metal_is_no_part_of_it():
    # smooth as a bottle's cap: its views differ as much as those of metal
    light, curve = synthetic.sun_and_uneven_sky(), curve_from_name("filmic")
    halves = [(lambda at: at[:, 1] > 0.3, LACQUER), (lambda at: at[:, 1] <= 0.3, GOLD)]
    scene, _ = synthetic.ball(halves, light, curve)
    problem = make_problem(scene, curve)
    metallic = estimate_specular(problem, light, 4, 0)[0].metallic > 0.5
    seen = problem.radiance.seen.numpy()
    is_gold = scene.transport.surfels.position[:, 1] <= 0.3
    assert metallic[seen & is_gold].mean() > 0.9
    assert metallic[seen & ~is_gold].mean() < 0.1


def test_what_the_textures_subtract_is_what_their_views_show(ball):
    problem, light, is_gold, _ = ball
    specular, diffuse = estimate_specular(problem, light, 4, 0)
    transport = problem.scene.transport
    plastic = problem.radiance.seen.numpy() & ~is_gold & (specular.metallic < 0.5)
    seen_by = transport.observations.weight, transport.observations.positions
    share = texture_weights(seen_by, transport.surfels.position).numpy()[..., None]
    read = (problem.linear.numpy() * share).sum(1)
    below = ((read - specular.floor) / specular.kept)[plastic]
    # the same without highlights view by view
    expected = (diffuse.numpy() * share).sum(1)[plastic]
    np.testing.assert_allclose(np.median(below / expected, 0), 1, atol=0.01)
    assert np.quantile(np.abs(below / expected - 1), 0.9) < 0.03
