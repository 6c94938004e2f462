# SPDX-License-Identifier: Apache-2.0
"""Normals with a known grain: it goes, edges stay."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from robir.appearance.smooth_normals import SURFACE, LitSurface, smoothed
from robir.geometry.mesh.isosurface import plain_mesh
from robir.steps import Pipeline
from robir.transport.baked import Transport
from robir.transport.surfels import Surfels, sample_surfels


def grainy(normal, degrees, seed=0):
    """Normals (N, 3) turned at random by so much in each of two directions, root mean square."""
    noise = np.random.default_rng(seed).normal(size=normal.shape) * np.tan(np.radians(degrees))
    turned = normal + noise
    return (turned / np.linalg.norm(turned, axis=1, keepdims=True)).astype(np.float32)


def angles(first, second):
    return np.degrees(np.arccos((first * second).sum(1).clip(-1, 1)))


@pytest.fixture(scope="module")
def sphere():
    """A mesh and its samples, whose normals are their places."""
    solid = trimesh.creation.icosphere(subdivisions=4, radius=0.6)
    mesh = plain_mesh(np.asarray(solid.vertices), np.asarray(solid.faces))
    surfels = sample_surfels(mesh, 8000, np.random.default_rng(0))
    true = surfels.position / np.linalg.norm(surfels.position, axis=1, keepdims=True)
    return mesh, replace(surfels, normal=true.astype(np.float32))


def test_grain_goes(sphere):
    _, surfels = sphere
    noisy = replace(surfels, normal=grainy(surfels.normal, 6))
    found = smoothed(noisy.position, noisy.normal, noisy)
    before, after = (angles(normal, surfels.normal).mean() for normal in (noisy.normal, found))
    assert before > 7 and after < 0.35 * before
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), 1, rtol=1e-5)


def test_a_sphere_stays_one(sphere):
    _, surfels = sphere
    found = smoothed(surfels.position, surfels.normal, surfels)
    assert angles(found, surfels.normal).max() < 2


def test_edges_stay():
    """The six sides of a box, right up to its edges."""
    solid = trimesh.creation.box((0.8, 0.8, 0.8))
    position, face = trimesh.sample.sample_surface_even(solid, 6000, seed=1)
    true = solid.face_normals[face].astype(np.float32)
    noisy = Surfels(position=position.astype(np.float32), normal=grainy(true, 4), spacing=0.02)
    found = smoothed(noisy.position, noisy.normal, noisy)
    beside = np.sort(np.abs(position), axis=1)[:, 1] > 0.36
    assert beside.sum() > 200
    assert angles(found, true)[beside].mean() < 0.6 * angles(noisy.normal, true)[beside].mean()
    assert angles(found, true)[beside].max() < 20


def test_surfaces_are_freed_of_their_grain(sphere):
    mesh, surfels = sphere
    mesh = replace(mesh, normals=grainy(mesh.normals, 6))
    noisy = replace(surfels, normal=grainy(surfels.normal, 6))
    transport = Transport(surfels=noisy, visibility=None, observations=None)
    surface = LitSurface(mesh=mesh, transport=transport)
    found = Pipeline().run(SURFACE, surface)
    true = mesh.vertices / np.linalg.norm(mesh.vertices, axis=1, keepdims=True)
    assert angles(found.mesh.normals, true).mean() < 0.5 * angles(mesh.normals, true).mean()
    assert angles(found.transport.surfels.normal, surfels.normal).mean() < 3
