# SPDX-License-Identifier: Apache-2.0
"""A ball, half rough plastic and half metal, rendered by quadrature of the reflection integral."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from appearance import synthetic

from robir.appearance.light.problem import make_problem
from robir.appearance.material.config import MaterialConfig
from robir.appearance.material.gloss import estimate_gloss
from robir.appearance.material.metal import metal_parts, metal_samples
from robir.appearance.material.reflections import Reflections, view_rays
from robir.appearance.photometry.config import StatisticsConfig
from robir.appearance.photometry.statistics import darker_view_weights, sharpest_views
from robir.maths.tone import curve_from_name

MATERIAL = MaterialConfig()
LEVELS, PAINT_ERROR = MATERIAL.metal_levels, MATERIAL.metal.paint_error
GOLD = synthetic.Material(np.float32([0.9, 0.62, 0.25]), 0.3, specular=1.0)
PLASTIC = synthetic.Material(np.float32([0.12, 0.3, 0.35]), 0.56)
LACQUER = synthetic.Material(np.float32([0.07, 0.012, 0.015]), 0.15)
STRIP = 0.09
"""Half the width of a strip of metal, unit frame; neighbourhoods reach about twice as far."""


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
    gloss, diffuse = estimate_gloss(problem, light, 4, 0)
    seen = problem.radiance.seen.numpy()
    metallic = gloss.metallic > 0.5
    # along the border neighbours of both kinds judge together
    assert (metallic == is_gold)[seen].mean() > 0.95
    assert np.median(gloss.roughness[seen & is_gold]) == pytest.approx(GOLD.roughness, abs=0.08)
    np.testing.assert_allclose(np.median(gloss.metal[seen & is_gold], 0), GOLD.base, atol=0.08)
    plastic = seen & ~is_gold
    assert np.median(gloss.roughness[plastic]) == pytest.approx(PLASTIC.roughness, abs=0.08)
    # What is left of plastic without its highlights is Lambert's share, the same from everywhere.
    left = diffuse.numpy()[plastic]
    weight = problem.scene.transport.observations.weight[plastic] > 0
    share = np.where(weight[..., None], left, np.nan)
    spread = np.nanstd(share, axis=1) / np.nanmean(share, axis=1)
    whole = np.where(weight[..., None], radiance[plastic], np.nan)
    before = np.nanstd(whole, axis=1) / np.nanmean(whole, axis=1)
    assert np.nanmedian(spread) < 0.25 * np.nanmedian(before)
    assert sum(row["share"] for row in gloss.table) == pytest.approx(1)


def test_a_strip_of_metal_narrower_than_its_neighbourhoods_is_found():
    light, curve = synthetic.sun_and_uneven_sky(), curve_from_name("filmic")
    inside = [
        (lambda at: abs(at[:, 1]) < STRIP, GOLD),
        (lambda at: abs(at[:, 1]) >= STRIP, PLASTIC),
    ]
    scene, _ = synthetic.ball(inside, light, curve, 2000)
    is_gold = abs(scene.transport.surfels.position[:, 1]) < STRIP
    problem = make_problem(scene, curve)
    metallic = estimate_gloss(problem, light, 4, 0)[0].metallic > 0.5
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
    metallic = estimate_gloss(problem, light, 4, 0)[0].metallic > 0.5
    seen = problem.radiance.seen.numpy()
    is_gold = scene.transport.surfels.position[:, 1] <= 0.3
    assert metallic[seen & is_gold].mean() > 0.9
    assert metallic[seen & ~is_gold].mean() < 0.1


def test_what_the_textures_subtract_is_what_their_views_show(ball):
    problem, light, is_gold, _ = ball
    gloss, diffuse = estimate_gloss(problem, light, 4, 0)
    weight = problem.scene.transport.observations.weight
    plastic = problem.radiance.seen.numpy() & ~is_gold & (gloss.metallic < 0.5)
    sharpest = torch.from_numpy(sharpest_views(weight) > 0)
    darker = darker_view_weights(problem.linear, sharpest, StatisticsConfig())
    darker = darker.numpy()[..., None]
    read = (problem.linear.numpy() * darker).sum(1)
    below = ((read - gloss.floor) / gloss.kept)[plastic]
    # the same without highlights view by view
    expected = (diffuse.numpy() * darker).sum(1)[plastic]
    np.testing.assert_allclose(np.median(below / expected, 0), 1, atol=0.01)
    assert np.quantile(np.abs(below / expected - 1), 0.9) < 0.03


def test_roughness_of_metal_does_not_grow_with_the_errors_of_its_mesh(ball):
    problem, light, is_gold, _ = ball
    transport = problem.scene.transport
    # dents of 6 degrees, a few samples wide, under pictures of the round ball
    position = transport.surfels.position
    dents = 0.105 * np.stack([np.sin(25 * position[:, k]) for k in (1, 2, 0)], axis=1)
    normal = transport.surfels.normal + dents.astype(np.float32)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    surfels = replace(transport.surfels, normal=normal)
    scene = replace(problem.scene, transport=replace(transport, surfels=surfels))
    gloss, _ = estimate_gloss(make_problem(scene, problem.curve), light, 4, 0)
    gold = problem.radiance.seen.numpy() & is_gold
    assert (gloss.metallic[gold] > 0.5).mean() > 0.9
    assert np.median(gloss.roughness[gold]) == pytest.approx(GOLD.roughness, abs=0.08)


@pytest.mark.parametrize(
    ("paint", "metal", "likely", "certain"),
    [
        (PAINT_ERROR - 0.001, 0.01, False, False),
        (PAINT_ERROR + 0.001, PAINT_ERROR + 0.0015, True, False),
        (PAINT_ERROR + 0.001, PAINT_ERROR + 0.004, False, False),
        # what no paint leaves speaks for metal, though metal leaves as much
        (PAINT_ERROR + 0.02, PAINT_ERROR + 0.02, True, True),
        (PAINT_ERROR + 0.02, np.inf, False, False),
    ],
)
def test_metal_may_leave_the_more_the_more_paint_leaves(paint, metal, likely, certain):
    around = np.arange(4)[:, None].repeat(4, 1).T
    found = metal_samples(
        np.full((4, 7), paint, np.float32),
        np.full((4, 5), metal, np.float32),
        around,
        MATERIAL.metal,
    )
    np.testing.assert_array_equal(found, np.broadcast_to([[likely], [certain]], (2, 4)))


def parts_with(ball, one_in: int, dim: float, left: float = 0.0) -> int:
    """Parts of the gold if metal explains one in so many samples better, read dimmed.

    `left` is the display error that metal leaves.
    """
    problem, light, is_gold, _ = ball
    transport = problem.scene.transport
    rows = np.flatnonzero(problem.radiance.seen.numpy())
    rays = view_rays(
        transport.surfels, transport.observations, rows, transport.visibility.directions
    )
    likely = is_gold[rows]
    certain = likely & (np.arange(len(rows)) % one_in == 0)
    seen = problem.linear[rows][torch.from_numpy(rays.sample), torch.from_numpy(rays.view)]
    found = metal_parts(
        (likely, certain),
        (transport.surfels.position[rows], np.zeros((len(rows), 3)), transport.surfels.spacing),
        (Reflections(problem, light, rows), rays, dim * seen),
        np.full((len(rows), len(LEVELS)), left, np.float32),
        MATERIAL,
    )
    assert (found.part[likely] >= 0).all() == bool(len(found.base))
    return len(found.base)


@pytest.mark.parametrize(("one_in", "parts"), [(2, 1), (5, 0)])
def test_a_part_that_metal_hardly_explains_is_no_metal(ball, one_in, parts):
    assert parts_with(ball, one_in, 1.0) == parts


@pytest.mark.parametrize(("one_in", "parts"), [(1, 1), (2, 0)])
def test_a_dim_part_is_metal_if_nearly_all_of_it_is_certain(ball, one_in, parts):
    assert parts_with(ball, one_in, 0.4) == parts


@pytest.mark.parametrize(
    ("dim", "left", "parts"), [(0.4, 0.036, 1), (0.4, 0.063, 0), (1.0, 0.063, 1)]
)
def test_a_dim_part_is_metal_only_if_that_explains_it_well(ball, dim, left, parts):
    assert parts_with(ball, 1, dim, left) == parts


@pytest.mark.parametrize(
    ("size", "hue", "kept"), [(10, 1.1, False), (10, 0.4, True), (50, 1.1, True)]
)
def test_a_bit_of_another_hue_than_the_metal_is_paint(ball, size, hue, kept):
    problem, light, is_gold, _ = ball
    transport = problem.scene.transport
    rows = np.flatnonzero(problem.radiance.seen.numpy())
    rays = view_rays(
        transport.surfels, transport.observations, rows, transport.visibility.directions
    )
    reflections = Reflections(problem, light, rows)
    gold, rest = np.flatnonzero(is_gold[rows]), np.flatnonzero(~is_gold[rows])
    metal = np.isin(np.arange(len(rows)), np.concatenate([gold, rest[:size]]))
    # far from the gold; what is seen is a metal of either hue
    position = transport.surfels.position[rows].copy()
    position[rest] += 99.0
    tint = np.where(np.isin(rays.sample, gold)[:, None], 0.0, [hue, -0.5 * hue, -0.5 * hue])
    white = reflections.radiance(rays, LEVELS[0])[:, 1]
    found = metal_parts(
        (metal, metal),
        (position, np.zeros((len(rows), 3)), 9.0),
        (reflections, rays, white * torch.from_numpy(0.5 * np.exp(tint))),
        np.full((len(rows), len(LEVELS)), 0.0, np.float32),
        MATERIAL,
    )
    assert (found.part[gold] == 0).all()
    assert len(found.base) == 1 + kept
    np.testing.assert_array_equal(found.part[rest[:size]], int(kept) if kept else -1)
