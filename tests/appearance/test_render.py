# SPDX-License-Identifier: Apache-2.0
"""Our own re-renders of a ball whose light, paint and metal are known in closed form."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from appearance.synthetic import Material, ball, ball_radiance, sun_and_uneven_sky
from transport.shapes import looking_at

from robir.appearance.light.problem import make_problem
from robir.appearance.material.specular import SpecularMaterial
from robir.appearance.render import render_views
from robir.appearance.texture.texels import TexelAlbedo
from robir.capture.capture import View
from robir.geometry.mesh.isosurface import plain_mesh
from robir.geometry.mesh.tracer import EmbreeTracer
from robir.maths.tone import curve_from_name
from robir.transport.surfels import interpolate

PAINT, METAL = np.float32([0.5, 0.3, 0.2]), np.float32([0.6, 0.55, 0.4])
ROUGHNESS = 0.5


class UpperIsMetal:
    """Stands for the look-up in an atlas of two texels: paint below, metal above."""

    def __init__(self, mesh) -> None:
        self._mesh = mesh

    def __call__(self, face, barycentric):
        position, _ = interpolate(self._mesh, face, barycentric)
        return (position[:, 2] > 0).astype(np.int64)


@pytest.fixture(scope="module")
def asset():
    """The ball as reconstructed: problem, light, specular material and textured surface."""
    curve, light = curve_from_name("standard"), sun_and_uneven_sky()
    parts = [(lambda p: np.ones(len(p), bool), Material(PAINT, ROUGHNESS, 0.0))]
    scene, _ = ball(parts, light, curve, count=3000)
    problem = make_problem(scene, curve)
    count = len(scene.transport.surfels)
    is_metal = (scene.transport.surfels.position[:, 2] > 0).astype(np.float32)
    nothing = np.zeros((count, 3), np.float32)
    specular = SpecularMaterial(
        roughness=np.full(count, ROUGHNESS, np.float32),
        metallic=is_metal,
        metal=np.broadcast_to(METAL, (count, 3)).copy(),
        floor=nothing,
        kept=np.ones((count, 1), np.float32),
        has_highlights=True,
        table=(),
        choices=(),
    )
    texels = np.float32([0.0, 1.0])
    values = TexelAlbedo(
        albedo=np.stack([PAINT, METAL]),
        coverage=np.ones(2, np.int64),
        read=np.stack([PAINT, METAL]),
        uncertainty=0 * texels,
        roughness=np.full(2, ROUGHNESS, np.float32),
        metallic=texels,
    )
    import trimesh

    solid = trimesh.creation.icosphere(subdivisions=4, radius=0.8)
    mesh = plain_mesh(np.asarray(solid.vertices), np.asarray(solid.faces))
    tracer = EmbreeTracer(mesh.vertices, mesh.faces)
    return problem, light, specular, (mesh, tracer, UpperIsMetal(mesh), values)


def view_of(camera, mask):
    """A held-out photograph, black."""
    blank = np.zeros((camera.height, camera.width, 3), np.uint8)
    return View(name="a", image_display=blank, mask=mask, camera=camera, split="held_out")


@pytest.fixture(scope="module")
def shown(asset):
    """One view: what was rendered, where its pixels lie on the ball, and the light."""
    problem, light, specular, surface = asset
    _, tracer, *_ = surface
    camera = looking_at((2.6, -1.2, 0.4), size=48)
    origins, directions = camera.rays(camera.pixel_centres())
    hits = tracer.first_hits(origins.astype(np.float32), directions.astype(np.float32))
    shape = (camera.height, camera.width)
    mask = np.where(hits.face >= 0, 255, 0).astype(np.uint8).reshape(shape)
    (found,) = render_views(problem, light, specular, [view_of(camera, mask)], surface)
    position = origins + np.where(hits.face >= 0, hits.distance, 0)[:, None] * directions
    return found, position.reshape(*shape, 3), light


def expected_codes(position, light, base, specular):
    """Display codes (N, 3) of points on the ball as the camera sees them."""
    points = position.astype(np.float32), (position / 0.8).astype(np.float32)
    material = Material(base, ROUGHNESS, specular)
    camera = looking_at((2.6, -1.2, 0.4)).position.astype(np.float32)
    radiance = ball_radiance(points, material, light, camera[None])[:, 0]
    display = curve_from_name("standard").display_from_linear(torch.from_numpy(radiance))
    return 255 * display.clamp(0, 1).numpy()


@pytest.mark.parametrize(("upper", "base"), [(False, PAINT), (True, METAL)])
def test_the_matt_picture_is_albedo_times_irradiance_over_pi_also_on_metal(shown, upper, base):
    found, position, light = shown
    side = position[..., 2] > 0.06 if upper else position[..., 2] < -0.06
    chosen = (found.alpha == 255) & side
    assert chosen.sum() > 150
    codes = expected_codes(position[chosen], light, base, 0.0)
    off = np.abs(found.diffuse[chosen] - codes)
    assert np.median(off) < 2 and np.quantile(off, 0.95) < 8


def test_the_whole_material_has_highlights_and_metal_besides(shown):
    found, position, light = shown
    for side, base, specular in (
        (position[..., 2] < -0.06, PAINT, 0.04),
        (position[..., 2] > 0.06, METAL, 1.0),
    ):
        chosen = (found.alpha == 255) & side
        whole = expected_codes(position[chosen], light, base, specular)
        matt = expected_codes(position[chosen], light, base, 0.0)
        off = np.abs(found.image[chosen] - whole).mean()
        assert off < 8 and off < 0.5 * np.abs(matt - whole).mean() + 4


def test_a_photograph_that_was_placed_where_it_sees_nothing_is_empty(asset):
    problem, light, specular, surface = asset
    past = looking_at((0.0, -9.0, 6.0), target=(0.0, -9.0, 0.0), size=24)
    view = view_of(past, np.full((24, 24), 255, np.uint8))
    (found,) = render_views(problem, light, specular, [view], surface)
    assert not found.alpha.any() and not found.image.any() and not found.diffuse.any()
