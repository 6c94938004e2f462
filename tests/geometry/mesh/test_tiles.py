# SPDX-License-Identifier: Apache-2.0
"""Tiles in the atlas and back, by values worked by hand; a mesh keeps them in its file."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from export.tiled_run import TILES, own_uvs, tiled_mesh

from robir.errors import StorageError
from robir.geometry.mesh import tiles
from robir.geometry.mesh.triangles import Mesh


def test_numbers_are_those_of_the_convention():
    corners = np.array([[0, 0], [9, 0], [0, 1], [3, 2], [9, 99]])
    numbers = np.array([1001, 1010, 1011, 1024, 2000])
    assert tiles.numbers_of(corners).tolist() == numbers.tolist()
    assert tiles.corners_of(numbers).tolist() == corners.tolist()


@pytest.mark.parametrize(
    ("count", "side"), [(0, 1), (1, 1), (2, 2), (4, 2), (5, 3), (9, 3), (10, 4), (100, 10)]
)
def test_the_atlas_has_the_least_side_that_is_enough(count, side):
    assert tiles.cells_along(count) == side


def test_tiles_lie_row_by_row_in_the_atlas():
    places = np.array([[0.5, 0.25], [0.5, 0.25], [1.0, 0.0], [0.0, 1.0]])
    atlas = tiles.packed(places, np.array([0, 1, 2, 4]), 5)
    by_hand = [[0.5, 0.25], [1.5, 0.25], [3, 0], [1, 2]]
    assert atlas == pytest.approx(np.array(by_hand) / 3, abs=1e-7)
    assert tiles.within(atlas, np.array([0, 1, 2, 4]), 5) == pytest.approx(places, abs=1e-6)


def test_a_tile_is_cut_out_where_it_was_packed():
    rows, columns = np.mgrid[:6, :6]
    image = np.stack([columns, 5 - rows], axis=-1)  # texels from u = v = 0
    assert tiles.cell(image, 4, 5).reshape(-1, 2).min(axis=0).tolist() == [2, 2]
    assert tiles.cell(image, 4, 5).reshape(-1, 2).max(axis=0).tolist() == [3, 3]
    last = tiles.cell(image, 2, 5)
    assert last[-1, 0].tolist() == [4, 0]  # its lower left texel
    assert (tiles.cell(image, 0, 0) == image).all()


def test_a_face_is_in_the_tile_of_its_middle_also_at_a_border():
    triangle = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]])
    for count in (2, 5, 100):
        tile = np.arange(count)
        atlas = tiles.packed(np.tile(triangle, (count, 1)), np.repeat(tile, 3), count)
        faces = np.arange(3 * count).reshape(-1, 3)
        assert (tiles.tile_of_faces(atlas, faces, count) == tile).all()
    assert not tiles.tile_of_faces(atlas, faces, 0).any()


def test_a_mesh_tells_the_users_coordinates_and_keeps_its_tiles(tmp_path):
    mesh = tiled_mesh()
    assert mesh.cells == 2
    assert mesh.own_uvs()[mesh.uv_faces] == pytest.approx(own_uvs(), abs=1e-6)
    mesh.save(tmp_path / "mesh.npz")
    again = Mesh.load(tmp_path / "mesh.npz")
    assert again.tiles.tolist() == TILES.tolist()
    assert (again.uvs == mesh.uvs).all()
    plain = replace(mesh, tiles=TILES[:0])
    assert plain.cells == 1 and plain.own_uvs() is plain.uvs
    plain.save(tmp_path / "plain.npz")
    with np.load(tmp_path / "plain.npz", allow_pickle=False) as arrays:
        assert "tiles" not in arrays.files


@pytest.mark.parametrize("numbers", [[1001, 1003], [1003, 1001, 1011], [999, 1003, 1011]])
def test_tiles_that_cannot_be_are_damage(tmp_path, numbers):
    broken = replace(tiled_mesh(), tiles=np.array(numbers, np.int32))
    broken.save(tmp_path / "mesh.npz")
    with pytest.raises(StorageError, match="do not fit together"):
        Mesh.load(tmp_path / "mesh.npz")
