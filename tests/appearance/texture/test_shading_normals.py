# SPDX-License-Identifier: Apache-2.0
"""Vertex normals explain what evening took out of the albedo, where they may be wrong."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
import trimesh
from appearance import synthetic
from transport.shapes import mesh_of, patch

from robir.appearance.light.lobes import soft_lobes
from robir.appearance.light.problem import make_problem
from robir.appearance.texture.config import TextureConfig
from robir.appearance.texture.shading_normals import shading_normals
from robir.appearance.texture.texels import TexelAlbedo
from robir.geometry.mesh.isosurface import plain_mesh
from robir.maths.tone import curve_from_name
from robir.maths.vectors import fibonacci_sphere
from robir.transport.surfels import interpolate

CONFIG = TextureConfig()
LIGHT = synthetic.sun_and_uneven_sky()


def irradiance(normal: np.ndarray) -> np.ndarray:
    """Of the light on an unshadowed surface, (N, 3), the sky integrated over 2048 directions."""
    directions = fibonacci_sphere(2048)
    axes, sharpness = soft_lobes(synthetic.NUM_SOFT)
    sky = torch.exp(sharpness * (directions @ axes.T - 1)) @ LIGHT.amplitudes.soft
    facing = (torch.from_numpy(normal) @ directions.T).clamp(min=0)
    sun = torch.from_numpy(normal @ LIGHT.axes.T).clamp(min=0)
    return (facing @ sky * (4 * np.pi / 2048) + sun @ LIGHT.amplitudes.sharp).numpy()


def texels_of(mesh) -> tuple[np.ndarray, np.ndarray]:
    """Faces and barycentric coordinates of 16 texels a face."""
    rng = np.random.default_rng(3)
    face = np.repeat(np.arange(len(mesh.faces), dtype=np.int32), 16)
    return face, rng.dirichlet((1, 1, 1), len(face)).astype(np.float32)


def values_of(read: np.ndarray, albedo: np.ndarray, unknown: float = 0.05) -> TexelAlbedo:
    count = len(read)
    flat = np.zeros(count, np.float32)
    return TexelAlbedo(
        albedo=albedo.astype(np.float32),
        coverage=np.full(count, 5),
        disagreement=flat,
        read=read.astype(np.float32),
        unknown=flat + np.float32(unknown),
        uncertainty=flat,
        roughness=flat,
        metallic=flat,
    )


@pytest.fixture(scope="module")
def ball():
    """A grey ball whose mesh has bumpy normals: problem, mesh, true normals, atlas, values."""
    matte = synthetic.Material(
        base=np.array([0.5, 0.4, 0.3], np.float32), roughness=0.5, specular=0.0
    )
    curve = curve_from_name("standard")
    scene, _ = synthetic.ball([(lambda at: at[:, 0] < 9, matte)], LIGHT, curve)
    solid = trimesh.creation.icosphere(subdivisions=3, radius=0.8)
    true = plain_mesh(np.asarray(solid.vertices), np.asarray(solid.faces))
    bumps = 0.12 * np.sin(9 * true.vertices[:, [1, 2, 0]])
    wrong = true.normals + bumps
    wrong /= np.linalg.norm(wrong, axis=1, keepdims=True)
    mesh = replace(true, normals=wrong.astype(np.float32))
    atlas = texels_of(mesh)
    right = irradiance(interpolate(true, *atlas)[1])
    albedo = np.tile(matte.base, (len(right), 1))
    read = albedo * right / irradiance(interpolate(mesh, *atlas)[1])
    return make_problem(scene, curve), mesh, true.normals, atlas, values_of(read, albedo)


def test_the_evened_albedo_repeats_the_photographs_under_the_turned_normals(ball):
    problem, mesh, true, atlas, values = ball
    turned = shading_normals(problem, LIGHT, mesh, atlas, values)
    np.testing.assert_allclose(np.linalg.norm(turned, axis=1), 1, atol=1e-5)
    right = irradiance(true).mean(1)
    before = np.log(irradiance(mesh.normals).mean(1) / right)
    after = np.log(irradiance(turned).mean(1) / right)
    assert before.std() > 0.08
    assert after.std() < 0.4 * before.std()
    # what shading tells is one of two angles: the normals are not further off than they were
    before, after = (np.arccos((n * true).sum(1).clip(-1, 1)) for n in (mesh.normals, turned))
    assert after.mean() < 0.9 * before.mean()
    moved = np.arccos((turned * mesh.normals).sum(1).clip(-1, 1))
    assert moved.max() < CONFIG.shading_normals.most_turn


@pytest.mark.parametrize(
    "silent",
    [{}, {"coverage": 0}, {"metallic": 1.0}],
    ids=["nothing was taken out", "unseen", "metal"],
)
def test_normals_stay_where_nothing_speaks_against_them(ball, silent):
    problem, mesh, _, atlas, values = ball
    if silent:
        name, value = next(iter(silent.items()))
        values = replace(values, **{name: np.full_like(getattr(values, name), value)})
    else:
        values = replace(values, read=values.albedo)
    turned = shading_normals(problem, LIGHT, mesh, atlas, values)
    np.testing.assert_allclose(turned, mesh.normals, atol=1e-6)


def test_what_is_hardly_known_turns_little(ball):
    problem, mesh, _, atlas, values = ball
    doubtful = replace(values, unknown=np.full_like(values.unknown, 1.0))
    turned = [shading_normals(problem, LIGHT, mesh, atlas, some) for some in (values, doubtful)]
    turns = [np.linalg.norm(normals - mesh.normals, axis=1) for normals in turned]
    assert turns[1].mean() < 0.3 * turns[0].mean()


def test_a_plane_keeps_its_normals(ball):
    """A tenth less light on half of it is an error of the light: flat ground is not bumpy."""
    problem = ball[0]
    mesh = mesh_of(patch((-0.7, -0.7, 0), (1.4, 0, 0), (0, 1.4, 0), 10))
    atlas = texels_of(mesh)
    albedo = np.full((len(atlas[0]), 3), 0.5)
    darker = np.where(interpolate(mesh, *atlas)[0][:, :1] < 0, 0.9, 1.0)
    values = values_of(albedo * darker, albedo)
    turned = shading_normals(problem, LIGHT, mesh, atlas, values)
    assert np.degrees(np.arccos(turned[:, 2].clip(-1, 1))).max() < 1.0
