# SPDX-License-Identifier: Apache-2.0
"""The sphere's perfect result once more, its chart cut over three UDIM tiles.

Meridians divide it: what of the chart lies in a third of 0..1 along u is stretched over a tile. The
tiles 1001, 1003 and 1011 are no neighbours in the atlas of 2 by 2 as they are in the user's layout.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from evaluation import sphere_run

from robir.geometry.mesh.tiles import packed
from robir.geometry.mesh.triangles import Mesh
from robir.jobs.paths import JobPaths

TILES = np.array([1001, 1003, 1011], np.int32)
CORNERS = np.array([[0, 0], [2, 0], [0, 1]])
SIDE = sphere_run.TEXELS  # texels of a tile, as of the one texture of the sphere

# albedo of the tiles, linear, one colour each
SHADES = np.array([[0.6, 0.1, 0.1], [0.1, 0.6, 0.1], [0.1, 0.1, 0.6]])


def tiled_mesh() -> Mesh:
    """The sphere of the unit frame, a third of its faces in each tile."""
    mesh = sphere_run.sphere_mesh()
    corners = mesh.uvs[mesh.uv_faces].astype(np.float64)
    margin = sphere_run.MARGIN
    turn = (corners[..., 0] - margin) / (1 - 2 * margin)
    third = np.floor(3 * turn.mean(axis=1)).astype(int)
    place = np.stack([3 * turn - third[:, None], corners[..., 1]], axis=-1)
    atlas = packed(place.reshape(-1, 2), np.repeat(third, 3), 3)
    uv_faces = np.arange(len(atlas), dtype=np.int32).reshape(-1, 3)
    return replace(mesh, uvs=atlas, uv_faces=uv_faces, tiles=TILES)


def own_uvs() -> np.ndarray:
    """Texture coordinates (F, 3, 2) of the faces' corners as a user has them."""
    mesh = sphere_run.sphere_mesh()
    corners = mesh.uvs[mesh.uv_faces].astype(np.float64)
    turn = (corners[..., 0] - sphere_run.MARGIN) / (1 - 2 * sphere_run.MARGIN)
    third = np.floor(3 * turn.mean(axis=1)).astype(int)
    place = np.stack([3 * turn - third[:, None], corners[..., 1]], axis=-1)
    return place + CORNERS[third][:, None]


def tiled_textures() -> dict[str, np.ndarray]:
    """The atlas of 2 by 2 cells: every tile full of its shade from side to side, the last empty."""
    flat = np.zeros((2 * SIDE, 2 * SIDE), np.float32)
    cell = np.full(flat.shape, 3)
    for index, (row, column) in enumerate(((1, 0), (1, 1), (0, 0))):  # row 0 is at v = 1
        cell[row * SIDE : (row + 1) * SIDE, column * SIDE : (column + 1) * SIDE] = index
    inside = cell < 3
    shades = np.concatenate([SHADES, np.zeros((1, 3))])
    return {
        "albedo_linear": shades[cell].astype(np.float32),
        "roughness": np.where(inside, 0.2 + 0.2 * cell, 0.0).astype(np.float32),
        "metallic": flat,
        "coverage": np.where(inside, 6.0, 0.0).astype(np.float32),
        "uncertainty": np.where(inside, 0.1, 0.0).astype(np.float32),
        "inside": inside,
    }


def make_tiled_run(root: Path) -> JobPaths:
    """A result folder whose stages up to appearance are done."""
    paths = sphere_run.make_run(root, tiled_textures())
    tiled_mesh().save(paths.stage("geometry") / "mesh.npz")
    return paths
