# SPDX-License-Identifier: Apache-2.0
"""Photographs under another light are told from those exposed otherwise, and from metal."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from robir.appearance.photometry.comparison import COMPARISON, PhotoComparison, find_unlike, unlike
from robir.appearance.photometry.gains import solve_gains
from robir.capture.capture import View
from robir.geometry.mesh.isosurface import plain_mesh
from robir.geometry.mesh.tracer import EmbreeTracer
from robir.maths.vectors import fibonacci_sphere
from robir.steps import Pipeline
from robir.transport.baked import bake
from robir.transport.config import TransportConfig
from tests.geometry.scenes import ball, capture_of

VIEWS, POINTS = 24, 600

COVERED = (3, 4, 17)  # photographs during which a lamp is covered


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(5)


@pytest.fixture
def lit(rng):
    """Matte points under two lamps: log radiance (P, V, 3), what the second lamp gives, normals."""
    normals = fibonacci_sphere(POINTS).numpy().astype(np.float32)
    lamps = np.array([[0.6, 0.0, 0.8], [-0.6, 0.3, 0.74]])
    first, second = 0.15 + (normals @ lamps.T).clip(0).T
    albedo = rng.uniform(0.1, 0.5, (POINTS, 3))
    log = np.log(albedo * (first + second)[:, None])[:, None].repeat(VIEWS, 1)
    log = log + 0.05 * rng.standard_normal((POINTS, VIEWS, 1))
    log[rng.random((POINTS, VIEWS)) < 0.4] = np.nan
    return log, np.log(first / (first + second)), normals


def found(log: np.ndarray, normals: np.ndarray) -> list[int]:
    gains = solve_gains(log, normals)
    return np.flatnonzero(find_unlike(log, gains)[0]).tolist()


def test_photographs_with_a_lamp_covered_are_found(lit):
    log, loss, normals = lit
    assert found(log, normals) == []
    log[:, COVERED] += loss[:, None, None]
    assert found(log, normals) == list(COVERED)


def test_of_a_mirror_every_photograph_differs(rng):
    normals = fibonacci_sphere(POINTS).numpy().astype(np.float32)
    cameras = fibonacci_sphere(2 * VIEWS).numpy()[:VIEWS]
    mirrored = 2 * (normals @ cameras.T)[..., None] * normals[:, None] - cameras
    axes = rng.standard_normal((5, 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    radiance = 0.05 + np.exp(6 * (mirrored @ axes.T - 1)).sum(-1)
    assert found(np.log(radiance)[..., None].repeat(3, 2), normals) == []


def test_photographs_kept_aside_are_judged_by_the_others(lit):
    log, loss, normals = lit
    gains = solve_gains(log, normals)
    _, points = find_unlike(log, gains)
    aside = np.stack([log[:, 0], log[:, 1] + loss[:, None], log[:, 2] - 1.0], axis=1)
    assert unlike(aside, points).tolist() == [False, True, False]


def shaded(view: View) -> View:
    """A photograph during which the lamp on the left is covered: it grows darker to that side."""
    columns = np.flatnonzero((view.mask > 0).any(0))
    light = np.interp(np.arange(view.camera.width), columns[[0, -1]], [0.1, 1.0])
    dimmed = light[None, :, None] * view.image_display
    return replace(view, image_display=dimmed.astype(np.uint8))


def test_photographs_of_a_capture_are_named_those_kept_aside_as_well():
    solid = ball(0.7, (0.0, 0.0, 0.0))
    views = list(capture_of(solid, views=24).views)
    views[5], views[16] = shaded(views[5]), shaded(views[16])
    views[20] = replace(shaded(views[20]), split="held_out")
    views[21] = replace(views[21], split="held_out")
    capture = replace(capture_of(solid, views=1), views=tuple(views))
    mesh = plain_mesh(np.asarray(solid.vertices), np.asarray(solid.faces))
    config = TransportConfig(num_surfels=1500, num_directions=64)
    transport = bake(mesh, capture.train, config, seed=0)
    tracer = EmbreeTracer(mesh.vertices, mesh.faces)
    compared = PhotoComparison.of(transport, tracer, capture, 0)
    compared = Pipeline().run(COMPARISON, compared)
    odd = {views[number].name for number in (5, 16, 20)}
    assert compared.other_light == odd
    left = transport.without_views(compared.other_light).observations
    assert set(left.views) == {view.name for view in capture.train} - odd
    kept = np.isin(transport.observations.views, left.views)
    np.testing.assert_array_equal(left.display, transport.observations.display[:, kept])
    np.testing.assert_array_equal(left.weight, transport.observations.weight[:, kept])
