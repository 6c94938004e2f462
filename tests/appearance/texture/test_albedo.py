# SPDX-License-Identifier: Apache-2.0
"""Texels at shadow edges take their surroundings' albedo; all others keep their own."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from appearance import synthetic
from transport.shapes import looking_at, mesh_of, patch, photograph

from robir.appearance.light.lobes import soft_transfer
from robir.appearance.light.problem import make_problem, make_scene
from robir.appearance.material.specular import SpecularMaterial
from robir.appearance.texture.albedo import _STEP, ALBEDO, LitTexels, TexelState, texel_albedo
from robir.appearance.texture.residual_shading import Surroundings, with_normals
from robir.appearance.texture.shadow_edges import Reference, fill_clipped, solve_shadow_edges
from robir.appearance.texture.texels import NORMAL_SCALE, Texels
from robir.geometry.mesh.tracer import EmbreeTracer
from robir.maths.tone import curve_from_name
from robir.maths.vectors import fibonacci_sphere
from robir.steps import Pipeline
from robir.transport.baked import Transport
from robir.transport.observe import observe
from robir.transport.surfels import sample_surfels
from robir.transport.visibility import trace_visibility

SOFT, SUN = 0.5, 2.0
PAINTS = np.float32([[0.6, 0.5, 0.4], [0.1, 0.25, 0.3]])


@pytest.fixture
def shadow():
    """A floor of two paints across whose middle a shadow's edge runs, traced a little off."""
    steps = np.linspace(-0.6, 0.6, 48)
    x, y = (grid.ravel() for grid in np.meshgrid(steps, steps))
    position = np.stack([x, y, 0 * x], axis=1).astype(np.float32)
    normal = np.tile(np.float32([0, 0, 1]), (len(position), 1))
    facing = 0.8
    true_share = np.clip(0.5 + x / 0.1, 0, 1)
    traced = np.clip(0.5 + (x - 0.03) / 0.1, 0, 1)
    paint = PAINTS[(y > 0).astype(int)]
    exitant = paint * (SOFT + true_share * facing * SUN)[:, None]
    irradiance = SOFT + traced * facing * SUN
    parts = (
        np.full((len(x), 3), SOFT),
        (traced * facing)[:, None],
        np.full((1, 3), SUN),
    )
    edge = np.abs(x) < 0.12
    texels = Texels(position=position, normal=normal)
    return texels, np.full((len(x), 1), facing), paint, exitant, irradiance, parts, edge


def test_edges_take_the_paint_around_them_and_certain_texels_are_left_alone(shadow):
    texels, facing, paint, exitant, irradiance, parts, edge = shadow
    albedo = exitant / irradiance[:, None]
    reference = Reference(texels, albedo, ~edge)
    settled = solve_shadow_edges((albedo, exitant), parts, facing, texels, edge, reference)
    np.testing.assert_array_equal(settled[~edge], albedo[~edge])
    before = np.abs(np.log(albedo / paint))[edge].mean()
    after = np.abs(np.log(settled / paint))[edge]
    assert before > 0.15
    assert after.mean() < before / 3
    # The shares tried are a tenth apart.
    assert np.quantile(after, 0.95) < 0.16


def test_a_border_of_two_paints_within_a_shadow_edge_stays_where_it_is(shadow):
    steps = np.arange(-0.4, 0.4, 0.01)
    x, y = (grid.ravel() for grid in np.meshgrid(steps, steps))
    position = np.stack([x, y, 0 * x], axis=1).astype(np.float32)
    texels = Texels(position=position, normal=np.tile(np.float32([0, 0, 1]), (len(x), 1)))
    # beyond the border the same hue, twice as bright: less sun would explain it on this side too
    paint = PAINTS[0] * np.where(x < 0.04, 0.5, 1.0)[:, None]
    lit, sun = np.clip(0.5 + x / 0.06, 0, 1), 0.8 * SUN
    traced = np.clip(0.5 + (x - 0.01) / 0.06, 0, 1)
    exitant = paint * (SOFT + lit * sun)[:, None]
    albedo = exitant / (SOFT + traced * sun)[:, None]
    facing = np.full((len(x), 1), 0.8)
    parts = np.full((len(x), 3), SOFT), traced[:, None] * facing, np.full((1, 3), SUN)
    edge = np.abs(x) < 0.07
    reference = Reference(texels, albedo, ~edge)
    settled = solve_shadow_edges((albedo, exitant), parts, facing, texels, edge, reference)
    wrong = np.abs(np.log(settled / paint))[edge].mean(1)
    assert np.quantile(wrong, 0.9) < 0.16  # the shares tried are a tenth apart


def test_clipped_channels_rise_to_their_surroundings_and_never_fall(shadow):
    texels, _, paint, _, _, _, _ = shadow
    clipped = np.zeros(paint.shape, bool)
    middle = (np.abs(texels.position[:, 0]) < 0.1) & (texels.position[:, 1] < -0.15)
    clipped[middle, 0] = True
    measured = paint.copy()
    measured[middle] *= 0.7
    brighter = middle & (texels.position[:, 1] < -0.4)
    measured[brighter, 0] = 0.9
    reference = Reference(texels, paint, ~clipped.any(1))
    settled = fill_clipped(measured, clipped, reference, texels)
    np.testing.assert_array_equal(settled[~clipped], measured[~clipped])
    np.testing.assert_allclose(settled[middle & ~brighter, 0], PAINTS[0, 0], rtol=1e-6)
    np.testing.assert_array_equal(settled[brighter, 0], measured[brighter, 0])


def test_evening_removes_errors_of_the_light_and_keeps_texture_and_edges():
    steps = np.arange(-0.6, 0.6, 0.006)
    x, y = (grid.ravel().astype(np.float32) for grid in np.meshgrid(steps, steps))
    normal = np.tile(np.float32([0, 0, 1]), (len(x), 1))
    texels = Texels(position=np.stack([x, y, 0 * x], axis=1), normal=normal)
    paint = PAINTS[(y > 0).astype(int)]
    bumps = 0.12 * np.sin(2 * np.pi * x / 0.12) * np.sin(2 * np.pi * y / 0.12)
    stripes = 0.08 * np.sign(np.sin(2 * np.pi * (x + 1e-4) / 0.024))
    seen = (paint * np.exp(bumps + stripes)[:, None]).astype(np.float32)
    unknown = (np.abs(x - 0.2) < 0.02) & (np.abs(y + 0.3) < 0.02)
    seen[unknown] = 0.9
    disagreement = np.where(unknown, 1.0, 0.05).astype(np.float32)
    points = with_normals(texels.position, texels.normal, NORMAL_SCALE)
    left = np.log(Surroundings(points, _STEP).smoothed(seen, disagreement) / paint).mean(1)
    inner = (np.abs(y) > 0.05) & (np.maximum(np.abs(x), np.abs(y)) < 0.5) & ~unknown
    basis = np.stack([bumps, stripes, np.ones_like(x)], axis=1)[inner]
    (kept_bumps, kept_stripes, offset), *_ = np.linalg.lstsq(basis, left[inner], rcond=None)
    assert kept_bumps < 0.35
    assert kept_stripes == pytest.approx(1.0, abs=0.1)
    assert offset == pytest.approx(0.0, abs=0.02)
    edge = np.abs(y) < 0.02
    assert np.abs(left[edge] - stripes[edge]).mean() < 0.12
    middle = unknown & (np.abs(x - 0.2) < 0.01) & (np.abs(y + 0.3) < 0.01)
    assert np.abs(left[middle]).max() < 0.3


@pytest.mark.parametrize(("doubt", "share_left"), [(0.8, 0.25), (0.05, 0.75)])
def test_paint_that_is_hardly_known_becomes_what_surrounds_it(doubt, share_left):
    rng = np.random.default_rng(4)
    position = np.c_[rng.uniform(-0.5, 0.5, (6000, 2)), np.zeros(6000)].astype(np.float32)
    up = np.tile(np.float32([0, 0, 1]), (6000, 1))
    points = with_normals(position, up, NORMAL_SCALE)
    dark = np.hypot(position[:, 0], position[:, 1]) < 0.12
    albedo = np.tile(np.float32([0.3, 0.2, 0.1]), (6000, 1))
    albedo[dark] *= 0.4
    unknown = np.where(dark, doubt, 0.05).astype(np.float32)
    result = Surroundings(points, _STEP).smoothed(albedo, unknown)
    left = np.median(np.log(result[dark] / [0.3, 0.2, 0.1])) / np.log(0.4)
    assert left < share_left if doubt > 0.5 else left > share_left


def lit_floor(dielectrics, is_second):
    """Sun and sky on open ground, photographed: problem, light, texels, views, matte gloss, tracer.

    The second of the paints (2, 3) lies where `is_second` of the positions (N, 3) holds.
    """
    mesh = mesh_of(patch((-0.7, -0.7, 0), (1.4, 0, 0), (0, 1.4, 0), 4))
    tracer = EmbreeTracer(mesh.vertices, mesh.faces)
    surfels = sample_surfels(mesh, 500, np.random.default_rng(0))
    directions = fibonacci_sphere(256).numpy().astype(np.float32)
    visibility = trace_visibility(mesh, tracer, surfels, directions, 0.003)
    light = synthetic.true_light(1.5, 0.2)
    soft = soft_transfer(visibility, surfels, synthetic.NUM_SOFT)[:1]
    facing = float(synthetic.SUN[2])
    irradiance = (soft @ light.amplitudes.soft + facing * light.amplitudes.sharp).numpy()
    curve = curve_from_name("agx")

    def shade(points, face, view_dir):
        paint = dielectrics[is_second(points).astype(int)]
        return curve.display_from_linear(torch.from_numpy(paint * irradiance / np.pi)).numpy()

    cameras = [looking_at(place, size=96) for place in ((0, 0.4, 3), (1.6, 0, 2.2), (-1, -1, 2.5))]
    views = tuple(photograph(tracer, shade, camera, str(k)) for k, camera in enumerate(cameras))
    seen = observe(tracer, surfels.position, surfels.normal, views, 0.003)
    transport = Transport(surfels=surfels, visibility=visibility, observations=seen)
    sizes, rng = (1000, synthetic.NUM_SOFT), np.random.default_rng(0)
    scene = make_scene(transport, tracer, 0.003, sizes, rng)
    x, y = (grid.ravel() for grid in np.meshgrid(*2 * [np.linspace(-0.69, 0.69, 50)]))
    position = np.stack([x, y, 0 * x], axis=1).astype(np.float32)
    normal = np.tile(np.float32([0, 0, 1]), (len(position), 1))
    count = len(surfels)
    matte = SpecularMaterial(
        roughness=np.full(count, 0.5, np.float32),
        metallic=np.zeros(count, np.float32),
        floor=np.zeros((count, 3), np.float32),
        metal=np.ones((count, 3), np.float32),
        kept=np.ones((count, 1), np.float32),
        has_highlights=True,
        table=(),
        choices=(),
    )
    texels = Texels(position=position, normal=normal)
    return make_problem(scene, curve), light, texels, views, matte, tracer


def test_texels_of_a_lit_floor_have_their_paint():
    """Albedo is pi R / E, unseen texels borrow it."""
    problem, light, texels, views, matte, tracer = lit_floor(PAINTS, lambda at: at[:, 1] > 0)
    y = texels.position[:, 1]
    lit = LitTexels.of((problem, light), texels, views, tracer)
    start = TexelState.of(lit, matte)
    state = Pipeline().run(ALBEDO, start)
    values, disagreement = state.values, state.disagreement
    paint = PAINTS[(y > 0).astype(int)]
    inner = np.abs(y) > 0.05
    error = np.abs(values.albedo / paint - 1)
    assert error[inner].max() < 0.03
    unseen = values.coverage == 0
    assert 0 < unseen.mean() < 0.2
    np.testing.assert_array_equal(disagreement[unseen], 1)
    assert disagreement[inner & ~unseen].max() < 0.1
    seen_error = values.uncertainty[inner & ~unseen]
    assert seen_error.max() < 0.42
    assert np.all(values.uncertainty[unseen] > np.median(seen_error))
    np.testing.assert_allclose(values.roughness, 0.5, rtol=1e-6)
    # Views of a glossy surface agree as well as those of a dull one.
    glossy = replace(matte, floor=0.1 * problem.radiance.linear.numpy())
    start = TexelState.of(lit, glossy)
    again = Pipeline().run(ALBEDO, start)
    assert np.abs(again.values.albedo / values.albedo - 0.9)[inner & ~unseen].max() < 0.05
    np.testing.assert_allclose(
        again.disagreement[inner & ~unseen], disagreement[inner & ~unseen], atol=1e-6
    )


@pytest.mark.parametrize("has_highlights", [False, True])
def test_what_no_model_explains_is_shown_as_the_mean(has_highlights):
    """Photographs are shown no worse than their plain mean on the surface does."""
    problem, light, texels, views, matte, tracer = lit_floor(PAINTS, lambda at: at[:, 1] > 0)
    # each photograph is brighter or darker than any light that is common to all would have it
    factors = (0.8, 1.0, 1.25)
    views = tuple(
        replace(view, image_display=np.rint(view.image_display * factor).clip(0, 254).astype("u1"))
        for view, factor in zip(views, factors, strict=True)
    )
    specular = replace(matte, has_highlights=has_highlights)
    lit = LitTexels.of((problem, light), texels, views, tracer)
    values = texel_albedo(lit, specular, Pipeline())
    seen = observe(tracer, texels.position, texels.normal, views, 0.003)
    soft = problem.scene.soft[0] @ light.amplitudes.soft
    irradiance = (soft + float(synthetic.SUN[2]) * light.amplitudes.sharp[0]).numpy()
    radiance = torch.from_numpy(values.albedo * irradiance / np.pi)
    shown = problem.curve.display_from_linear(radiance).numpy()
    known = (seen.weight > 0) & ((seen.weight > 0).sum(1) == len(views))[:, None]
    codes = seen.display / 255.0
    mean = codes[known.all(1)].mean(1, keepdims=True)
    worst = np.mean((codes[known.all(1)] - mean) ** 2)
    ours = np.mean((codes[known.all(1)] - shown[known.all(1), None]) ** 2)
    # the mean of all views alike has the least squares there are; darker views lie 2 dB below
    assert 10 * np.log10(ours / worst) < 0.2
