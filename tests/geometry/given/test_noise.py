# SPDX-License-Identifier: Apache-2.0
"""Noise of known size on shapes with known normals: measured, taken away, and nothing else."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from robir.geometry.given.noise import vertex_noise, without_noise
from robir.geometry.mesh.isosurface import plain_mesh
from robir.geometry.mesh.simplify import decimate, with_creases
from robir.geometry.mesh.smoothing import face_geometry

NOISE = 0.003


def sphere(level: int = 5) -> trimesh.Trimesh:
    return trimesh.creation.icosphere(level, 1.0)


def cube(level: int = 5) -> trimesh.Trimesh:
    solid = trimesh.creation.box((1.15, 1.15, 1.15))
    for _ in range(level):
        solid = solid.subdivide()
    return solid


def arrays(solid: trimesh.Trimesh) -> tuple[np.ndarray, np.ndarray]:
    return np.array(solid.vertices, np.float64), np.array(solid.faces, np.int32)


def noisy(solid: trimesh.Trimesh, seed: int = 0) -> np.ndarray:
    return solid.vertices + NOISE * np.random.default_rng(seed).normal(size=solid.vertices.shape)


def true_normals(solid: trimesh.Trimesh, points: np.ndarray) -> np.ndarray:
    """Of a sphere about the origin, or of a cube, at points (..., 3) on or near it."""
    if solid.volume > 2:
        return points / np.linalg.norm(points, axis=-1, keepdims=True)
    axis = np.abs(points).argmax(-1)[..., None]
    return np.where(np.arange(3) == axis, np.sign(points), 0.0)


def angles(one: np.ndarray, two: np.ndarray) -> np.ndarray:
    return np.degrees(np.arccos(np.clip((one * two).sum(-1), -1, 1)))


@pytest.mark.parametrize("solid", [sphere(4), sphere(5), cube(4), cube(5)])
@pytest.mark.parametrize("seed", [0, 1])
def test_noise_is_measured(solid, seed):
    assert vertex_noise(noisy(solid, seed), arrays(solid)[1]) == pytest.approx(NOISE, rel=0.2)


@pytest.mark.parametrize(("made", "left"), [(sphere, 0.3), (cube, 0.3)])
def test_faces_turn_back_to_the_true_normals(made, left):
    """By what remains of the error's mean, over all faces; the facets' own share is in it."""
    solid = made()
    faces = arrays(solid)[1]
    before = noisy(solid)
    after, _ = without_noise(before, faces)
    true = true_normals(solid, face_geometry(arrays(solid)[0], faces)[2])
    was, now = (angles(face_geometry(x, faces)[0], true) for x in (before, after))
    assert was.mean() > 8
    assert now.mean() < left * was.mean()
    assert np.linalg.norm(after - before, axis=1).max() < 3.1 * NOISE
    assert np.median(np.linalg.norm(after - arrays(solid)[0], axis=1)) < NOISE * 1.6


def test_edges_of_a_cube_stay_sharp():
    solid = cube()
    after, _ = without_noise(noisy(solid), arrays(solid)[1])
    mesh = with_creases(plain_mesh(after, arrays(solid)[1]))
    centres = solid.triangles_center
    true = true_normals(solid, centres)
    near = np.sort(np.abs(centres), axis=1)[:, 1] > 0.53  # faces along an edge
    error = angles(mesh.normals[mesh.faces], true[:, None]).mean(1)
    assert near.sum() > 500
    assert np.median(error[near]) < 4
    assert np.quantile(error[near], 0.9) < 12


@pytest.mark.parametrize(
    "solid",
    [
        *(sphere(level) for level in (1, 2, 3, 4)),
        *(cube(level) for level in (0, 1, 2, 3, 4)),
        trimesh.creation.torus(0.7, 0.2, major_sections=90, minor_sections=30),
        trimesh.creation.cylinder(0.4, 1.2, sections=48),
        trimesh.creation.cone(0.5, 1.0, sections=40).subdivide().subdivide(),
    ],
)
def test_a_mesh_without_noise_is_left_alone(solid):
    vertices, faces = arrays(solid)
    after, noise = without_noise(vertices, faces)
    assert noise == 0.0
    assert after is vertices


def wavy() -> trimesh.Trimesh:
    """A rounded shape that curves to both sides, finely meshed."""
    solid = sphere(5)
    direction = np.array(solid.vertices)
    bumps = (
        np.sin(4 * direction[:, :1]) * np.cos(5 * direction[:, 1:2]) * np.sin(3 * direction[:, 2:])
    )
    solid.vertices = direction * (1 + 0.2 * bumps)
    return solid


@pytest.mark.parametrize("faces", [20480, 5000, 2000, 800, 400])
def test_what_decimation_leaves_is_no_noise(faces):
    mesh = decimate(plain_mesh(*arrays(wavy())), faces)
    vertices = mesh.vertices.astype(np.float64)
    after, noise = without_noise(vertices, mesh.faces)
    assert noise == 0.0
    assert after is vertices


def test_faces_without_an_area_and_lonely_vertices_do_no_harm():
    solid = sphere(4)
    vertices = np.concatenate([noisy(solid), [[9.0, 9.0, 9.0]]])
    faces = np.concatenate([arrays(solid)[1], [[0, 0, 1], [5, 5, 5]]]).astype(np.int32)
    after, noise = without_noise(vertices, faces)
    assert noise == pytest.approx(NOISE, rel=0.2)
    assert np.isfinite(after).all()
    assert after[-1] == pytest.approx(vertices[-1])
