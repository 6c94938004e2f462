# SPDX-License-Identifier: Apache-2.0
"""Which texture coordinates of the user's mesh are kept, and why others are not."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from geometry.given.test_ready import given
from geometry.given.test_surface import Quiet

from robir.capture.mesh_file import Detail, Given
from robir.geometry.config import GeometryConfig
from robir.geometry.given.layout import Layout, own_layout
from robir.geometry.given.ready import FLAT, made_ready
from robir.geometry.mesh.isosurface import plain_mesh

# a whole tile, border to border
SQUARE = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])


def squares(*places, size: float = 1.0, shared: bool = False) -> Given:
    """Squares that lie about in space, each with its place in the texture, of two faces."""
    uvs = np.concatenate([size * SQUARE + np.array(place) for place in places])
    shift = np.repeat(3 * np.arange(len(places)), 4)[:, None]
    vertices = np.column_stack([np.tile(SQUARE, (len(places), 1)) + shift, 0 * uvs[:, 0]])
    faces = np.concatenate(
        [np.array([[0, 1, 2], [0, 2, 3]]) + 4 * index for index in range(len(places))]
    )
    if shared:  # one vertex for each place of the texture
        uvs, index = np.unique(uvs, axis=0, return_inverse=True)
        vertices, faces = np.column_stack([uvs, 0 * uvs[:, 0]]), index.reshape(-1)[faces]
    return Given(vertices=vertices, faces=faces.astype(np.int32), uvs=uvs)


def own_of(given: Given, found: Layout) -> np.ndarray:
    """The user's texture coordinates as the layout gives them back."""
    mesh = replace(
        plain_mesh(given.vertices, given.faces),
        uvs=found.uvs, uv_faces=found.uv_faces, tiles=found.tiles,
    )  # fmt: skip
    assert mesh.is_whole()
    return mesh.own_uvs()[mesh.uv_faces]


@pytest.mark.parametrize(
    ("one", "numbers"),
    [
        (squares((0, 0), (1, 0), (2, 0)), [1001, 1002, 1003]),
        (squares((0, 0), (1, 0), (2, 0), shared=True), [1001, 1002, 1003]),
        (squares((0, 0), (1, 0), (0, 1), (1, 1), shared=True), [1001, 1002, 1011, 1012]),
        (squares((3, 2), (9, 0)), [1010, 1024]),
        (squares((0.1, 0.1), (1.1, 0.1), size=0.5), [1001, 1002]),  # the same place, two tiles
        (squares((0, 0), (0, 99)), [1001, 1991]),
        (
            squares(*((i, j) for j in range(10) for i in range(10)), size=0.3),
            list(range(1001, 1101)),
        ),
    ],
)
def test_tiles_are_kept_border_to_border(one, numbers):
    found = own_layout(one)
    assert isinstance(found, Layout), found
    assert found.tiles.tolist() == numbers
    assert own_of(one, found) == pytest.approx(one.uvs[one.faces], abs=1e-5)
    assert found.uvs.min() >= 0 and found.uvs.max() <= 1
    assert found.notes == ()


@pytest.mark.parametrize(
    ("one", "reason"),
    [
        (squares((0, 0), (0.5, 0)), r"0\.00 to 1\.50\) and 2 of its faces reach from one tile"),
        (squares((0, 0), size=4.0), "2 of its faces reach"),
        (squares((0, 0), (-1, 0)), "below 0 there are no tiles"),
        (squares((0, 0), (10, 0)), "tiles end at u = 10"),
        (squares((0, 0), (0, 100)), "and v = 100"),
        (squares(*((k % 10, k // 10) for k in range(101))), "on 101 tiles, and .* 100 at most"),
        (squares((0, 0), (1, 0), (1, 0)), r"50% of its own overlap in tile 1002"),
        (squares((0, 0), (1e30, 0)), "where no tiles are"),
        (squares((0, 0), (1, 0), size=0.01), "next to nothing"),
        (squares((0.2, 0.2), (0.4, 0.2), size=0.4), "25% of its own overlap, so"),
    ],
)
def test_what_is_no_layout_is_said(one, reason):
    found = own_layout(one)
    assert isinstance(found, str)
    assert re.search(reason, found), found


@pytest.mark.parametrize("corner", [(1, 0), (4, 7), (-1, 0), (25, -3)])
def test_what_lies_in_one_other_square_is_shifted_and_told(corner):
    one = squares(corner)
    found = own_layout(one)
    assert isinstance(found, Layout), found
    assert not len(found.tiles)
    assert found.uvs[found.uv_faces] == pytest.approx(squares((0, 0)).uvs[one.faces])
    (note,) = found.notes
    assert f"from {corner[0]}, {corner[1]}" in note


def test_faces_without_an_area_open_no_tile_of_their_own():
    """On the right border of tile 1003, on the left one of 1003, and in a corner of 1001."""
    one = squares((0, 0), (2, 0))
    lines = np.array([[[3, 0.2], [3, 0.4], [3, 0.9]], [[2, 0.2], [2, 0.4], [2, 0.9]], [[1, 1]] * 3])
    count = len(one.vertices)
    with_lines = Given(
        vertices=np.concatenate([one.vertices, np.ones((9, 3))]),
        faces=np.concatenate([one.faces, count + np.arange(9, dtype=np.int32).reshape(3, 3)]),
        uvs=np.concatenate([one.uvs, lines.reshape(-1, 2)]),
    )
    found = own_layout(with_lines)
    assert isinstance(found, Layout), found
    assert found.tiles.tolist() == [1001, 1003]
    # a border is left by a few millionths of a tile, so that rounding cannot cross it
    own = own_of(with_lines, found)
    assert own == pytest.approx(with_lines.uvs[with_lines.faces], abs=5e-5)


def tiled_ball() -> Given:
    """The ball of `given`, its layout over the tiles 1001, 1002, 1011 and 1012."""
    one = given()
    return replace(one, uvs=2 * one.uvs)


@pytest.mark.parametrize("face_budget", [8000, 500])
def test_a_mesh_over_tiles_keeps_faces_and_layout(face_budget):
    one = replace(tiled_ball(), detail=None, normals=None)
    ready = made_ready(one, GeometryConfig(face_budget=face_budget), Quiet().warn)
    assert not ready.is_unwrapped_anew
    mesh = ready.mesh
    assert mesh.is_whole()
    assert mesh.tiles.tolist() == [1001, 1002, 1011, 1012]
    assert mesh.vertices[mesh.faces] == pytest.approx(one.vertices[one.faces], abs=1e-6)
    assert mesh.own_uvs()[mesh.uv_faces] == pytest.approx(one.uvs[one.faces], abs=1e-6)


def test_every_tile_gets_the_normal_map_of_its_faces():
    one = tiled_ball()
    maps = tuple(np.full((8, 8, 3), shade, np.uint8) for shade in (1, 2, 3))
    corner = np.floor(one.uvs[one.faces].mean(axis=1)).astype(int)
    tile = corner[:, 0] + 2 * corner[:, 1]
    of_tile = np.array([2, 0, -1, 1], np.int32)
    named = replace(one, detail=Detail(maps=maps, of_face=of_tile[tile]))
    ready = made_ready(named, GeometryConfig(), Quiet().warn)
    assert [bumps[0, 0, 0] for bumps in ready.normal_maps] == [3, 1, FLAT[0, 0, 0], 2]
    # one for all repeats from tile to tile
    again = made_ready(one, GeometryConfig(), Quiet().warn)
    assert len(again.normal_maps) == 4
    assert all(bumps is one.detail.maps[0] for bumps in again.normal_maps)
    mixed = of_tile[tile]
    mixed[0] = (mixed[0] + 1) % 3
    broken = replace(one, detail=Detail(maps=maps, of_face=mixed))
    ready = made_ready(broken, GeometryConfig(), Quiet().warn)
    assert not ready.normal_maps
    assert ready.mesh.tiles.size == 4
    assert any("different ones in one tile, or some have none" in note for note in ready.notes)
