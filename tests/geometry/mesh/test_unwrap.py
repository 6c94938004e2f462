# SPDX-License-Identifier: Apache-2.0
"""The atlas: every face has texels, the rasteriser agrees with barycentric arithmetic."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from robir.errors import StorageError
from robir.geometry.mesh import unwrap
from robir.geometry.mesh.isosurface import plain_mesh
from robir.geometry.mesh.simplify import with_creases
from robir.geometry.mesh.triangles import Mesh


def ball(subdivisions: int = 3) -> Mesh:
    solid = trimesh.creation.icosphere(subdivisions=subdivisions)
    return plain_mesh(np.asarray(solid.vertices), np.asarray(solid.faces))


def test_rasterised_texels_lie_where_their_barycentric_coordinates_say() -> None:
    mesh = unwrap.unwrap(ball(), 60.0, pytest.fail)
    size = 128
    faces, share = unwrap.rasterise_atlas(mesh, size)
    row, column = np.nonzero(faces >= 0)
    assert len(row) > 0.3 * size * size
    uv = np.einsum("tk,tkc->tc", share[row, column], mesh.uvs[mesh.uv_faces[faces[row, column]]])
    np.testing.assert_allclose(uv[:, 0], (column + 0.5) / size, atol=1e-5)
    np.testing.assert_allclose(uv[:, 1], 1.0 - (row + 0.5) / size, atol=1e-5)
    points = np.einsum(
        "tk,tkc->tc", share[row, column], mesh.vertices[mesh.faces[faces[row, column]]]
    )
    np.testing.assert_allclose(np.linalg.norm(points, axis=1), 1.0, atol=0.02)


def test_rasteriser_finds_the_texels_a_brute_force_search_finds() -> None:
    mesh = unwrap.unwrap(ball(1), 60.0, pytest.fail)
    size = 24
    faces, _ = unwrap.rasterise_atlas(mesh, size)
    centres = (np.arange(size) + 0.5) / size
    for row in range(size):
        for column in range(size):
            point = np.array([centres[column], 1.0 - centres[row]])
            found = any(_inside(point, mesh.uvs[corners]) for corners in mesh.uv_faces)
            assert (faces[row, column] >= 0) == found


def _inside(point: np.ndarray, triangle: np.ndarray) -> bool:
    matrix = np.vstack([triangle.T.astype(np.float64), np.ones(3)])
    if abs(np.linalg.det(matrix)) < 1e-12:
        return False
    return bool((np.linalg.solve(matrix, np.append(point, 1.0)) >= -1e-9).all())


def test_texture_coordinates_that_fill_no_texel_are_refused() -> None:
    uvs = np.float32([[0.1, 0.1], [0.1, 0.1], [0.1, 0.1]])
    corners = np.int32([[0, 1, 2]])
    mesh = Mesh(
        vertices=np.eye(3, dtype=np.float32),
        faces=corners,
        normals=np.eye(3, dtype=np.float32),
        uvs=uvs,
        uv_faces=corners,
    )
    with pytest.raises(StorageError, match="fill no texel"):
        unwrap.rasterise_atlas(mesh, 16)


def test_timeout_decimates_and_at_last_gives_each_triangle_its_own_chart(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(unwrap, "_in_child", lambda mesh, seconds: None)
    said: list[str] = []
    mesh = unwrap.unwrap(ball(), 1.0, said.append)
    assert mesh.is_unwrapped
    assert len(mesh.faces) <= 1280 // 4 + 4
    assert len(said) == 3 and "every triangle" in said[-1]
    faces, _ = unwrap.rasterise_atlas(mesh, 256)
    assert len(np.unique(faces[faces >= 0])) == len(mesh.faces)


def test_a_child_that_takes_too_long_is_stopped() -> None:
    assert unwrap._in_child(ball(), 0.01) is None


def test_creases_split_a_box_into_its_sides_and_leave_a_ball_whole() -> None:
    box = trimesh.creation.box()
    split = with_creases(plain_mesh(np.asarray(box.vertices), np.asarray(box.faces)))
    assert len(split.vertices) == 24
    np.testing.assert_allclose(np.abs(split.normals).max(axis=1), 1.0, atol=1e-6)
    whole = with_creases(ball())
    assert len(whole.vertices) == len(ball().vertices)
    np.testing.assert_allclose(whole.normals, whole.vertices, atol=0.02)
