# SPDX-License-Identifier: Apache-2.0
"""Textures over UDIM tiles: sizes that memory holds, and texels that keep to their tile."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from export.tiled_run import TILES

from robir.appearance.config import AppearanceConfig
from robir.appearance.render import AtlasLookup
from robir.appearance.texture.detail import SharpestViews, finer
from robir.appearance.texture.texels import TexelAlbedo
from robir.appearance.texturing import most_side, solved_side
from robir.geometry.mesh.isosurface import plain_mesh
from robir.geometry.mesh.tracer import EmbreeTracer
from robir.geometry.mesh.triangles import Mesh
from robir.maths.tone import curve_from_name


@pytest.mark.parametrize(
    ("cells", "texture_size", "tile"),
    [
        (2, 2048, 2048),
        (2, 8192, 4096),
        (3, 8192, 2048),  # three times 4096 were 12288
        (4, 2048, 2048),
        (10, 8192, 512),
        (10, 128, 128),
        (2, 3000, 2048),
    ],
)
def test_a_tile_is_a_power_of_two_and_all_together_fit_into_memory(cells, texture_size, tile):
    config = AppearanceConfig(texture_size=texture_size)
    assert most_side(config, cells) == cells * tile <= 8192
    solved = solved_side(config, cells)
    assert solved <= most_side(config, cells)
    assert np.log2(solved / cells) % 1 == 0
    assert 512 / 2**0.5 <= solved <= 512 * 2**0.5 or tile == 128
    # so that doubling leads from one to the other
    assert np.log2(most_side(config, cells) / solved) % 1 == 0


def test_one_texture_is_as_large_as_was_asked_for():
    config = AppearanceConfig(texture_size=3000, shading_size=700)
    assert (solved_side(config), most_side(config)) == (700, 3000)


def tiles_side_by_side(width: float) -> Mesh:
    """Two squares beside each other in the atlas, the right one full, the left one up to a width.

    Of four texels a tile, 0.8 leaves out the left tile's last column but for a rim.
    """
    square = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    uvs = np.concatenate([square * [width, 1], square + np.array([1, 0])]) / 2
    vertices = np.column_stack([np.concatenate([square, square + np.array([3, 0])]), np.zeros(8)])
    faces = np.array([[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]], np.int32)
    mesh = plain_mesh(vertices.astype(np.float32), faces)
    return replace(mesh, uvs=uvs.astype(np.float32), uv_faces=faces, tiles=TILES[:2])


def inside(columns: int) -> np.ndarray:
    """Texels of both tiles, so many columns of the left one."""
    texels = np.zeros((8, 8), bool)
    texels[4:, :columns] = texels[4:, 4:] = True
    return texels


def test_a_point_on_a_rim_takes_a_texel_of_its_own_tile():
    mesh = tiles_side_by_side(0.8)
    right = np.array([[0.0, 0.5, 0.5]], np.float32)  # u = 0.8 of the left tile: on the rim
    columns = np.nonzero(inside(3))[1]
    found = AtlasLookup(mesh, inside(3))(np.array([0], np.int32), right)
    assert columns[found].tolist() == [2]
    alone = AtlasLookup(replace(mesh, tiles=TILES[:0]), inside(3))(np.array([0], np.int32), right)
    assert columns[alone].tolist() == [4], "else nothing is shown"


def test_finer_texels_are_read_from_their_own_tile():
    mesh, held = tiles_side_by_side(1.0), inside(4)
    paint = np.where((np.nonzero(held)[1] < 4)[:, None], 0.2, 0.6) * np.ones(3, np.float32)
    flat = np.zeros(len(paint), np.float32)
    values = TexelAlbedo(
        albedo=paint, coverage=flat.astype(np.int64), read=paint,
        uncertainty=flat, roughness=flat, metallic=flat,
    )  # fmt: skip
    tracer = EmbreeTracer(mesh.vertices, mesh.faces)
    nothing = SharpestViews((mesh, tracer), [], curve_from_name("standard"))
    fine, after = finer(values, held, nothing, 32)
    is_left = np.nonzero(fine)[1] < 16
    assert is_left.any() and not is_left.all()
    expected = np.where(is_left[:, None], 0.2, 0.6) * np.ones(3)
    assert after.albedo == pytest.approx(expected, abs=1e-6)
