# SPDX-License-Identifier: Apache-2.0
"""What tells metal from dark paint, and what a part is taken for that is read badly."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from appearance import synthetic

from robir.appearance.light.problem import make_problem
from robir.appearance.material.config import MaterialConfig
from robir.appearance.material.gloss import estimate_gloss
from robir.appearance.material.metal import (
    metal_errors,
    metal_parts,
    neighbourhoods,
)
from robir.appearance.material.reflections import Reflections, view_rays
from robir.maths.tone import curve_from_name

MATERIAL = MaterialConfig()
LEVELS = MATERIAL.metal_levels
GOLD = synthetic.Material(np.float32([0.9, 0.62, 0.25]), 0.3, specular=1.0)
SOOT = synthetic.Material(np.float32([0.2, 0.14, 0.1]), 0.3, specular=1.0)
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


def test_a_mirror_as_dark_as_no_metal_is_paint(gold, soot):
    share = [
        float((gloss.metallic[problem.radiance.seen.numpy()] > 0.5).mean())
        for gloss, problem in ((estimate_gloss(*ball, 4, 0)[0], ball[0]) for ball in (gold, soot))
    ]
    assert share[0] > 0.9
    assert share[1] < 0.05


def test_bright_metal_explains_what_is_bright_alone(gold, soot):
    for (problem, light), is_bright in ((gold, True), (soot, False)):
        rows = np.flatnonzero(problem.radiance.seen.numpy())
        around = neighbourhoods(
            problem.scene.transport.surfels.position[rows], MATERIAL.metal.neighbours
        )
        asking = np.full((len(rows), 7), 0.06, np.float32)
        free, bright = metal_errors(problem, light, rows, asking, around)
        assert np.isfinite(free).any()
        ratio = bright.min(1) / free.min(1)
        assert (np.median(ratio) < 1.05) == is_bright
        assert (np.median(ratio) > 2.0) != is_bright


def read_of(problem, light, rows, radiance, errors, certain):
    """Parts of all samples as they are placed; `radiance` (M, 3) is what is seen."""
    transport = problem.scene.transport
    rays = view_rays(
        transport.surfels, transport.observations, rows, transport.visibility.directions
    )
    reflections = Reflections(problem, light, rows)
    position = transport.surfels.position[rows].copy()
    position[: len(rows) // 2] += FAR
    place = position, np.zeros((len(rows), 3)), 9.0
    seen = radiance(reflections, rays)
    everything = np.ones(len(rows), bool)
    return metal_parts((everything, certain), place, (reflections, rays, seen), errors, MATERIAL)


@pytest.mark.parametrize(("one_in", "own"), [(1, True), (2, False)])
def test_a_part_that_is_half_explained_is_of_the_others_metal(gold, one_in, own):
    problem, light = gold
    rows = np.flatnonzero(problem.radiance.seen.numpy())
    half = len(rows) // 2
    # the first half reads dimmer by mistake
    certain = (np.arange(len(rows)) % one_in == 0) | (np.arange(len(rows)) >= half)

    def radiance(reflections, rays):
        dim = np.where(rays.sample < half, 0.45, 0.8)[:, None]
        return reflections.radiance(rays, LEVELS[0])[:, 1] * torch.from_numpy(dim).float()

    errors = np.zeros((len(rows), len(LEVELS)), np.float32)
    found = read_of(problem, light, rows, radiance, errors, certain)
    dim, sure = found.base[found.part[0]].mean(), found.base[found.part[-1]].mean()
    assert sure == pytest.approx(0.8, abs=0.05)
    # 0.55 is the darkest that any metal is taken for
    assert (dim < 0.57) == own
    assert (dim > 0.6) != own


def test_what_reads_dark_as_rough_metal_alone_is_sharper(gold):
    problem, light = gold
    rows = np.flatnonzero(problem.radiance.seen.numpy())
    # where a rough metal mirrors the sun in every view
    sun = problem.scene.transport.surfels.normal[rows] @ light.axes[0]
    rows = rows[sun > np.quantile(sun, 0.7)]
    errors = np.tile(np.float32([0.06, 0.06, 0.06, 0.06, 0.055]), (len(rows), 1))

    def radiance(reflections, rays):
        sharp, rough = (
            reflections.radiance(rays, level)[:, 1] for level in (LEVELS[0], LEVELS[-1])
        )
        factor = float((sharp / rough).median())
        assert factor < 0.8
        return sharp * MATERIAL.metal.darkest_reading / factor**0.5

    found = read_of(problem, light, rows, radiance, errors, np.ones(len(rows), bool))
    assert len(found.base) == 2
    assert (found.roughness < LEVELS[-1]).all()
    assert MATERIAL.metal.bright_metal >= MATERIAL.metal.darkest_reading
