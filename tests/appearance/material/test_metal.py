# SPDX-License-Identifier: Apache-2.0
"""What tells metal from paint, what a part is made of, and what metal has no part in."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from appearance import synthetic

from robir.appearance.light.problem import make_problem
from robir.appearance.material import highlights, metal
from robir.appearance.material.metal import (
    MetalParts,
    base_colour_posterior,
    metal_errors,
    metal_parts,
)
from robir.appearance.material.reflections import Reflections, view_rays
from robir.appearance.material.specular import estimate_specular
from robir.appearance.material.trial import MaterialTrial
from robir.maths.tone import curve_from_name

LEVELS = highlights.LEVELS[: metal._NUM_LEVELS]
GOLD = synthetic.Material(np.float32([0.9, 0.62, 0.25]), 0.3, specular=1.0)
SOOT = synthetic.Material(np.float32([0.2, 0.14, 0.1]), 0.3, specular=1.0)
PLASTIC = synthetic.Material(np.float32([0.12, 0.3, 0.35]), 0.56)
FAR = 99.0


def ball_of(material):
    """The problem of a ball of one material, and its light."""
    light, curve = synthetic.sun_and_uneven_sky(), curve_from_name("filmic")
    scene, _ = synthetic.ball([(lambda at: at[:, 1] < FAR, material)], light, curve)
    return make_problem(scene, curve), light


@pytest.fixture(scope="module")
def gold():
    return ball_of(GOLD)


@pytest.fixture(scope="module")
def soot():
    return ball_of(SOOT)


@pytest.fixture(scope="module")
def halves():
    """A ball half of gold and half of plastic: its problem, light, and which samples are gold."""
    light, curve = synthetic.sun_and_uneven_sky(), curve_from_name("filmic")
    parts = [(lambda at: at[:, 1] > 0, GOLD), (lambda at: at[:, 1] <= 0, PLASTIC)]
    scene, _ = synthetic.ball(parts, light, curve)
    return make_problem(scene, curve), light, scene.transport.surfels.position[:, 1] > 0


def test_bright_metal_explains_what_is_bright_alone(gold, soot):
    for (problem, light), is_bright in ((gold, True), (soot, False)):
        free, bright = metal_errors(problem, light, np.flatnonzero(problem.radiance.seen.numpy()))
        ratio = bright.min(1) / free.min(1)
        assert (np.median(ratio) < 1.05) == is_bright
        assert (np.median(ratio) > 2.0) != is_bright


@pytest.mark.parametrize("strength", [0.7, 2.0])
def test_metal_is_told_under_a_light_of_wrong_strength(halves, strength):
    problem, light, is_gold = halves
    wrong = light.tinted(torch.full((3,), float(np.log(strength))))
    specular, _ = estimate_specular(problem, wrong, 4, 0)
    is_metal, seen = specular.metallic > 0.5, problem.radiance.seen.numpy()
    assert is_metal[seen & is_gold].mean() > 0.85
    assert is_metal[seen & ~is_gold].mean() < 0.1


def read_of(problem, light, odds, shown):
    """Parts of the seen samples in two halves far apart; `shown` (M, 3) of white metal is seen."""
    transport, rows = problem.scene.transport, np.flatnonzero(problem.radiance.seen.numpy())
    rays = view_rays(
        transport.surfels, transport.observations, rows, transport.visibility.directions
    )
    reflections = Reflections(problem, light, rows)
    position = transport.surfels.position[rows].copy()
    position[: len(rows) // 2] += FAR
    white = reflections.radiance(rays, LEVELS[0])[:, 1]
    errors = np.tile(np.float32([0.01, *[0.02] * (len(LEVELS) - 1)]), (len(rows), 1))
    return metal_parts(
        odds(len(rows)),
        (position, np.zeros((len(rows), 3)), 9.0),
        (reflections, rays, white * torch.from_numpy(shown(rays.sample, len(rows))).float()),
        errors,
    )


def test_a_part_that_is_misread_is_of_the_other_parts_metal(gold):
    problem, light = gold
    certain = np.float64(metal._METAL_ODDS + 1)

    def shown(sample, count):
        return np.where((sample < count // 4)[:, None], 0.01, 0.8) * np.array([1.0, 0.8, 0.5])

    found = read_of(problem, light, lambda count: np.full(count, certain), shown)
    assert len(found.base) == 2
    alone = np.exp(base_colour_posterior(np.log([[0.01, 0.008, 0.005]]), np.array([500])))[0]
    # half of what shows the first part is misread
    assert (found.base.max(1) > 0.65).all()
    assert alone.max() > 0.4


def test_base_colours_are_posterior_means(monkeypatch):
    """Monte Carlo: what is drawn of metals and read with errors is told without a bias."""
    brightness = metal._BRIGHTNESS - 0.5
    for name, value in (
        ("_MISREAD_SHARE", 0.0),
        ("_ALIKE", 1.0),
        ("_ENOUGH", 0.0),
        ("_BRIGHTNESS", brightness),
    ):
        monkeypatch.setattr(metal, name, value)
    rng = np.random.default_rng(3)
    count = 4000
    bright = brightness + metal._BRIGHTNESS_SPREAD * rng.normal(size=count)
    blue = metal._BLUE + metal._BLUE_SPREAD * rng.normal(size=count)
    green = metal._GREEN_SPREAD * rng.normal(size=count)

    def colour(bright, blue, green):
        log = np.stack([-0.5 * blue - green / 3, 2 / 3 * green, 0.5 * blue - green / 3], axis=1)
        return log - log.max(1, keepdims=True) + bright[:, None]

    read = colour(
        bright + metal._BRIGHTNESS_ERROR * rng.normal(size=count),
        blue + metal._BLUE_ERROR * rng.normal(size=count),
        green + metal._GREEN_ERROR * rng.normal(size=count),
    )
    one = np.array([500])
    told = np.concatenate([base_colour_posterior(row[None], one) for row in read])
    # one part alone is the whole scene, and read twice: once as the scene, once as the part
    off = (told[:, 2] - told[:, 0]) - blue
    assert abs(off.mean()) < 4 * off.std() / np.sqrt(count)
    assert off.std() < (read[:, 2] - read[:, 0] - blue).std()
    assert off.std() < metal._BLUE_SPREAD
    assert (told <= 0).all()


def test_metal_takes_no_part_in_the_light_but_where_there_is_hardly_anything_else(halves, gold):
    problem, light, is_gold = halves
    specular, _ = estimate_specular(problem, light, 4, 0)
    rows = specular.solved_by(problem.scene.rows, metal.SOLVED_WITHOUT)
    assert is_gold[rows].mean() < 0.1 < is_gold[problem.scene.rows].mean()
    whole, light = gold
    specular, _ = estimate_specular(whole, light, 4, 0)
    assert len(specular.solved_by(whole.scene.rows, metal.SOLVED_WITHOUT)) == len(whole.scene.rows)


def test_parts_are_metal_where_photographs_prove_it(halves, monkeypatch):
    problem, light, is_gold = halves
    rows = np.flatnonzero(problem.radiance.seen.numpy())
    parts = MetalParts(
        part=np.where(is_gold[rows], 0, 1),
        base=np.stack([GOLD.base, PLASTIC.base]),
        roughness=np.float32([GOLD.roughness, PLASTIC.roughness]),
    )
    trial = MaterialTrial.of(problem, light, rows)
    dielectric = np.zeros((len(rows), len(highlights.LEVELS)), np.float32)
    kept, choice = metal.tested_parts(parts, trial, dielectric)
    assert (kept.part == np.where(is_gold[rows], 0, -1)).all()
    assert choice.why.startswith("1 of 2 parts")
    monkeypatch.setattr(metal, "_PROVEN", 1e3)
    assert (metal.tested_parts(parts, trial, dielectric)[0].part == -1).all()
