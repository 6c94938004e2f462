# SPDX-License-Identifier: Apache-2.0
"""Joined charts: far fewer, flat without much stretch, no two of them at one place."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from robir.geometry.mesh import merging
from robir.geometry.mesh.charts import xatlas_charts
from robir.geometry.mesh.isosurface import plain_mesh
from robir.geometry.mesh.unwrap import plane_cross, rasterise_atlas


@pytest.fixture(scope="module")
def rough() -> tuple[trimesh.Trimesh, np.ndarray, np.ndarray]:
    """A ball with knobs, dents and noise, 1280 faces, and its charts."""
    solid = trimesh.creation.icosphere(subdivisions=3)
    x, y, z = 4 * solid.vertices.T
    solid.vertices *= (1 + 0.15 * np.sin(x) * np.cos(y) + 0.1 * np.sin(2 * z))[:, None]
    solid.vertices += np.random.default_rng(0).normal(0, 0.03, solid.vertices.shape)
    return solid, *xatlas_charts(solid.vertices.astype(np.float32), solid.faces.astype(np.int32))


def number_of_charts(corners: np.ndarray) -> int:
    one, other = corners[:, [0, 1]].ravel(), corners[:, [1, 2]].ravel()
    links = coo_matrix((np.ones(len(one)), (one, other)), shape=2 * (corners.max() + 1,))
    return connected_components(links, directed=False)[0]


def stretch(solid: trimesh.Trimesh, uvs: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Singular values (F, 2) of each face's map, one being no stretch in the mean."""
    a, b, c = np.moveaxis(solid.triangles, 1, 0)
    along = (b - a) / np.linalg.norm(b - a, axis=1, keepdims=True)
    across = np.cross(solid.face_normals, along)
    rest = np.einsum("nec,nkc->nke", np.stack([b - a, c - a], axis=1), np.stack([along, across], 1))
    u, v, w = np.moveaxis(uvs[corners].astype(float), 1, 0)
    slope = np.stack([v - u, w - u], axis=2) @ np.linalg.inv(rest)
    values = np.linalg.svd(slope, compute_uv=False)
    return values / np.sqrt(np.average(values.prod(axis=1), weights=solid.area_faces))


def test_charts_are_few_and_hardly_stretched(rough):
    solid, uvs, corners = rough
    assert number_of_charts(corners) <= 7  # xatlas alone makes 14
    values = stretch(solid, uvs, corners)
    squares = np.average((values**-2).mean(axis=1), weights=solid.area_faces)
    assert squares**0.5 < 1.08  # xatlas alone 1.03
    assert np.quantile(values[:, 0] / values[:, 1], 0.95) < 1.8


def test_no_two_faces_have_one_place(rough):
    solid, uvs, corners = rough
    mesh = replace(plain_mesh(solid.vertices, solid.faces), uvs=uvs, uv_faces=corners)
    found, _ = rasterise_atlas(mesh, 1024)
    a, b, c = np.moveaxis(uvs[corners].astype(float), 1, 0)
    area = np.abs(plane_cross(b - a, c - a)) / 2
    assert (found >= 0).mean() == pytest.approx(area.sum(), rel=0.01)


def test_sides_of_a_box_are_unfolded():
    box = trimesh.creation.box().subdivide()
    apart = np.arange(3 * len(box.faces)).reshape(-1, 3)
    plane = np.array([[0.0, 0], [1, 0], [0, 1]])
    shift = 2.0 * np.arange(len(box.faces))[:, None, None] * [1, 0]
    atlas = (plane + shift).reshape(-1, 2).astype(np.float32), apart.astype(np.int32)
    uvs, corners = merging.merged_charts(
        box.vertices.astype(np.float32), box.faces.astype(np.int32), atlas
    )
    assert number_of_charts(corners) <= 8  # of 48
    assert stretch(box, uvs, corners) == pytest.approx(1.0, abs=0.35)
