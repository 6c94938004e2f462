# SPDX-License-Identifier: Apache-2.0
"""Paint that solved texels lack, from photographs of a floor whose paint is known."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from transport.shapes import looking_at, mesh_of, patch

from robir.appearance.texture.detail import SharpestViews, finer
from robir.appearance.texture.lost_detail import regained
from robir.appearance.texture.texels import TexelAlbedo
from robir.appearance.texturing import pixel_width, texture_side
from robir.capture.capture import View
from robir.geometry.mesh.tracer import EmbreeTracer
from robir.geometry.mesh.triangles import Mesh
from robir.geometry.mesh.unwrap import rasterise_atlas
from robir.maths.tone import curve_from_name
from robir.transport.surfels import interpolate

SOLVED, SIDE = 64, 256
CURVE = curve_from_name("standard", {})
LIGHT = 0.8


def paint_at(points: np.ndarray) -> np.ndarray:
    """Albedo (N, 3): 25 and 18 waves a unit, which solved texels blur, and 2.5, which not."""
    x, y = points[:, 0], points[:, 1]
    wave = 0.5 + 0.15 * np.sin(2 * np.pi * 25 * x) + 0.12 * np.sin(2 * np.pi * 18 * y)
    wave += 0.12 * np.sin(2 * np.pi * 2.5 * x)
    return (wave[:, None] * np.stack([0.6 + 0 * x, 0.5 + 0.1 * x, 0.4 - 0.1 * y], axis=1)).clip(
        0.02
    )


def floor() -> Mesh:
    mesh = mesh_of(patch((-1, -1, 0), (2, 0, 0), (0, 2, 0), 6))
    uvs = 0.02 + 0.96 * 0.5 * (mesh.vertices[:, :2] + 1.0)
    return replace(mesh, uvs=uvs.astype(np.float32), uv_faces=mesh.faces)


def photograph(
    position, name: str, specular=None, dimmed: float = 1.0, size: int = 500, paint=paint_at
) -> View:
    """The floor under even light, at its own exposure; `specular` adds radiance to points."""
    camera = looking_at(position, size=size, focal=1.1)
    fine = camera.resized(2 * size, 2 * size)
    origins, directions = fine.rays(fine.pixel_centres())
    points = origins - directions * (origins[:, 2:] / directions[:, 2:])
    radiance = LIGHT * paint(points) + (0.0 if specular is None else specular(points))
    mean = (dimmed * radiance).reshape(size, 2, size, 2, 3).mean(axis=(1, 3))
    shown = CURVE.display_from_linear(torch.from_numpy(mean.astype(np.float32))).numpy()
    held = (np.abs(points[:, :2]) < 1).all(1).reshape(size, 2, size, 2).all(axis=(1, 3))
    return View(
        name=name,
        image_display=np.rint(255 * shown).clip(0, 255).astype(np.uint8),
        mask=np.where(held, 255, 0).astype(np.uint8),
        camera=camera,
        split="train",
    )


def solved(mesh: Mesh) -> tuple[np.ndarray, TexelAlbedo]:
    """The paint as means over the solved texels."""
    face, barycentric = rasterise_atlas(mesh, 8 * SOLVED)
    position, _ = interpolate(mesh, face[face >= 0], barycentric[face >= 0])
    full = np.zeros((8 * SOLVED, 8 * SOLVED, 4))
    full[face >= 0] = np.concatenate([paint_at(position), np.ones((len(position), 1))], axis=1)
    sums = full.reshape(SOLVED, 8, SOLVED, 8, 4).sum(axis=(1, 3))
    means = sums[..., :3] / np.maximum(sums[..., 3:], 1.0)
    inside = rasterise_atlas(mesh, SOLVED)[0] >= 0
    count = int(inside.sum())
    flat = np.full(count, 0.25, np.float32)
    return inside, TexelAlbedo(
        albedo=means[inside].astype(np.float32),
        coverage=np.full(count, 7),
        read=means[inside].astype(np.float32),
        uncertainty=flat,
        roughness=flat,
        metallic=np.zeros(count, np.float32),
        irradiance=np.full((count, 3), LIGHT, np.float32),
    )


PLACES = [(0.3, 0.2, 2.2), (1.2, 0.3, 1.9), (-0.9, 0.8, 1.9), (0.2, -1.1, 2.0), (-0.6, -0.5, 2.1)]


def made_finer(views: list[View]) -> tuple[np.ndarray, np.ndarray]:
    """Errors of the logarithm of albedo, well inside the floor: as solved, and made finer."""
    mesh = floor()
    inside, values = solved(mesh)
    tracer = EmbreeTracer(mesh.vertices, mesh.faces)
    face, barycentric = rasterise_atlas(mesh, SIDE)
    position, _ = interpolate(mesh, face[face >= 0], barycentric[face >= 0])
    truth = np.log(paint_at(position))
    middle = (np.abs(position) < 0.8).all(1)
    nothing = SharpestViews((mesh, tracer), [], CURVE)
    before = finer(values, inside, nothing, SIDE)[1].albedo
    held, after = finer(values, inside, SharpestViews((mesh, tracer), views, CURVE), SIDE)
    assert (held == (face >= 0)).all()
    assert set(after.coverage) == {7}
    errors = [np.abs(np.log(albedo) - truth)[middle].mean(1) for albedo in (before, after.albedo)]
    return errors[0], errors[1]


def test_detail_comes_back_whatever_the_exposure():
    exposures = (1.0, 0.7, 0.85, 0.6, 0.9)
    places = zip(PLACES, exposures, strict=True)
    views = [photograph(place, str(n), dimmed=d) for n, (place, d) in enumerate(places)]
    before, after = made_finer(views)
    assert before.mean() > 0.1
    assert after.mean() < 0.35 * before.mean()


def test_a_highlights_edge_is_no_paint():
    """One view has a hard highlight that the others do not have there."""

    def spot(points):
        return 0.1 * (np.hypot(points[:, 0] - 0.2, points[:, 1]) < 0.3)[:, None]

    views = [photograph(p, str(n), spot if n == 0 else None) for n, p in enumerate(PLACES)]
    before, after = made_finer(views)
    assert after.mean() < 0.4 * before.mean()


def speckled(points: np.ndarray, contrast: float = 0.5) -> np.ndarray:
    """Albedo (N, 3) with eight waves a unit, which a mean over four solved texels evens out."""
    return 0.4 * np.exp(contrast * np.sin(2 * np.pi * 8 * points[:, 0]))[:, None] * np.ones(3)


def regained_by(
    paint, albedo, irradiance=None, grain: float = 0.0
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Places (N, 3) well inside the floor, and log albedo there: as solved, and regained.

    `paint` is what photographs show, by places; `albedo` and `irradiance` are solved.
    """
    mesh = floor()
    inside, values = solved(mesh)
    face, barycentric = rasterise_atlas(mesh, SOLVED)
    where = face[inside], barycentric[inside].astype(np.float32)
    position, _ = interpolate(mesh, *where)
    values = replace(values, albedo=albedo(position).astype(np.float32))
    if irradiance is not None:
        values = replace(values, irradiance=irradiance(position).astype(np.float32))
    rng, views = np.random.default_rng(5), []
    for number, place in enumerate(PLACES):
        view = photograph(place, str(number), paint=paint)
        noisy = view.image_display + rng.normal(0, grain, view.image_display.shape)
        views.append(replace(view, image_display=np.rint(noisy).clip(1, 254).astype(np.uint8)))
    sharpest = SharpestViews((mesh, EmbreeTracer(mesh.vertices, mesh.faces)), views, CURVE)
    after = regained(values, where, sharpest, 0.004)
    middle = (np.abs(position) < 0.8).all(1)
    logs = (np.log(part.albedo[middle]) for part in (values, after))
    return position[middle], *logs


def test_speckles_that_the_mean_has_lost_come_back():
    place, before, after = regained_by(speckled, lambda points: speckled(points, 0.1))
    truth = np.log(speckled(place))
    assert np.abs(after - truth).mean() < 0.45 * np.abs(before - truth).mean()


def test_what_the_mean_has_kept_stays():
    _, before, after = regained_by(speckled, speckled)
    assert (before == after).all()


def test_grain_of_photographs_is_no_detail():
    def plain(points):
        return np.full((len(points), 3), 0.4)

    _, before, after = regained_by(plain, plain, grain=10.0)
    assert np.abs(after - before).mean() < 0.01


def test_an_edge_of_the_light_is_no_paint():
    """Beside x = 0.1 half of the light is missing, which the solve knows or does not know."""

    def plain(points):
        return np.full((len(points), 3), 0.4)

    def half(points):
        return np.where(points[:, :1] < 0.1, 0.4, 0.2) * np.ones(3)

    _, before, after = regained_by(half, plain, irradiance=half)
    assert np.abs(after - before).max() < 0.02
    _, before, after = regained_by(half, plain)
    assert np.abs(after - before).max() > 0.1


def test_a_texel_is_as_wide_as_a_pixel():
    """A camera straight above at distance 2 with 100 pixels of focal length: 0.02 a pixel."""
    camera = looking_at((0, 0, 2), size=100, focal=1.0)
    far = looking_at((0, 0, 4), size=100, focal=1.0)
    spots = np.zeros((5, 3), np.float32)
    facing = [[1.0, 1.0], [0.64, 1.0], [0.64, 0.0], [0.25, 0.0], [0.0, 0.0]]
    seen = SimpleNamespace(weight=np.array(facing), views=("near", "far"))
    transport = SimpleNamespace(
        observations=seen, surfels=SimpleNamespace(position=spots, normal=spots)
    )
    width = pixel_width(transport, {"near": camera, "far": far})  # type: ignore[arg-type]
    assert width == pytest.approx(0.02 / 0.8)


def test_a_texture_has_a_texel_for_every_pixel():
    """The floor is 2 wide and takes .48 of the atlas along a side: 2 / .02 / .48 = 208 texels."""
    mesh = floor()
    mesh = replace(mesh, uvs=0.5 * mesh.uvs)
    assert texture_side(mesh, 0.02, (32, 512)) == 256
    assert texture_side(mesh, 0.02, (32, 200)) == 128
    assert texture_side(mesh, 0.02, (512, 1024)) == 512
    assert texture_side(mesh, 0.02, (256, 128)) == 128
    assert texture_side(mesh, np.inf, (32, 512)) == 32
