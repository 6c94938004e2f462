# SPDX-License-Identifier: Apache-2.0
"""The mesh value: triangles with vertex normals and, once unwrapped, texture coordinates."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from robir.capture.arrays import stored_arrays
from robir.errors import StorageError
from robir.geometry.mesh.tiles import (
    ACROSS,
    FIRST,
    ROWS,
    cells_along,
    corners_of,
    tile_of_faces,
    within,
)
from robir.jobs.paths import replacing

# file of the mesh for light in the geometry stage's folder, beside mesh.npz; often absent
LIGHT = "light.npz"

_FORM = {
    "vertices": "f V 3", "faces": "i F 3", "normals": "f V 3", "uvs": "f + 2", "uv_faces": "i F 3",
    "tiles?": "i +",
}  # fmt: skip

# of a mesh that may have no texture coordinates
_BARE = _FORM | {"uvs": "f * 2", "uv_faces": "i * 3"}


@dataclass(frozen=True, slots=True, kw_only=True)
class Mesh:
    """Triangle mesh, counter-clockwise seen from outside."""

    vertices: NDArray[np.float32]  # (Nv, 3) float32
    faces: NDArray[np.int32]  # (Nf, 3) int32, indices into vertices
    normals: NDArray[np.float32]  # (Nv, 3) float32, unit, outward
    uvs: NDArray[np.float32]  # (Nu, 2) float32 in [0, 1], v upwards; empty before unwrapping
    uv_faces: NDArray[np.int32]  # (Nf, 3) int32, indices into uvs; empty before unwrapping
    # (Nt,) int32, rising numbers of the UDIM tiles that are the atlas' cells; empty where the atlas
    # is one texture
    tiles: NDArray[np.int32] = field(default_factory=lambda: np.zeros(0, np.int32))

    @property
    def cells(self) -> int:
        """Cells along a side of the atlas."""
        return cells_along(len(self.tiles))

    @property
    def is_unwrapped(self) -> bool:
        """Whether every face has texture coordinates."""
        return len(self.uv_faces) == len(self.faces)

    def own_uvs(self) -> NDArray[np.float32]:
        """Texture coordinates (Nu, 2) over the tiles; those of the atlas where there are none."""
        count = len(self.tiles)
        if not count:
            return self.uvs
        tile = np.zeros(len(self.uvs), np.int64)
        tile[self.uv_faces] = tile_of_faces(self.uvs, self.uv_faces, count)[:, None]
        return within(self.uvs, tile, count) + corners_of(self.tiles)[tile].astype(np.float32)

    def save(self, path: Path) -> None:
        """Write as .npz, atomically."""
        tiles = {"tiles": self.tiles} if len(self.tiles) else {}
        with replacing(path) as temporary, temporary.open("wb") as file:
            np.savez_compressed(
                file,
                vertices=self.vertices,
                faces=self.faces,
                normals=self.normals,
                uvs=self.uvs,
                uv_faces=self.uv_faces,
                **tiles,
            )

    @classmethod
    def load(cls, path: Path, *, is_bare: bool = False) -> Mesh:
        """Read what `save` wrote; a bare mesh may lack texture coordinates.

        `StorageError` if it is missing or damaged.
        """
        mesh = cls(**stored_arrays(path, _BARE if is_bare else _FORM))
        if not mesh.is_whole():
            raise StorageError(f"{path} is damaged: its arrays do not fit together")
        return mesh

    def is_whole(self) -> bool:
        """Whether every vertex has a normal and every face its corners and its tile."""
        pairs = ((self.faces, self.vertices), (self.uv_faces, self.uvs))
        are_there = all(
            not len(corners) or (corners.min() >= 0 and corners.max() < len(points))
            for corners, points in pairs
        )
        fit = len(self.normals) == len(self.vertices) and len(self.uv_faces) in (0, len(self.faces))
        return are_there and fit and self._has_its_tiles()

    def _has_its_tiles(self) -> bool:
        """Whether the tiles are such, and every face lies in one of them."""
        if not len(self.tiles):
            return True
        are_tiles = self.tiles.min() >= FIRST and self.tiles.max() < FIRST + ACROSS * ROWS
        if not are_tiles or (np.diff(self.tiles) <= 0).any():
            return False
        tile = tile_of_faces(self.uvs, self.uv_faces, len(self.tiles))
        return bool((tile < len(self.tiles)).all())


def mesh_for_light(folder: Path) -> Mesh:
    """The mesh of the geometry stage's folder that light is solved on.

    It is a copy with fewer faces where the user handed in one with many, else the mesh itself. The
    copy has no texture coordinates where the mesh kept the user's.
    """
    light = folder / LIGHT
    return Mesh.load(light, is_bare=True) if light.exists() else Mesh.load(folder / "mesh.npz")


def face_geometry(
    vertices: NDArray[np.floating], faces: NDArray[np.integer]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Unit normals (Nf, 3) and areas (Nf,) of triangles."""
    corners = vertices[faces].astype(np.float64)
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(cross, axis=1)
    return cross / np.maximum(length, 1e-30)[:, None], 0.5 * length


def vertex_normals(vertices: NDArray[np.float32], faces: NDArray[np.int32]) -> NDArray[np.float32]:
    """Area-weighted unit normals (Nv, 3); (0, 0, 1) for vertices of no face."""
    corners = vertices[faces].astype(np.float64)
    areas = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    total = np.zeros((len(vertices), 3))
    for corner in range(3):
        np.add.at(total, faces[:, corner], areas)
    length = np.linalg.norm(total, axis=1, keepdims=True)
    safe = np.where(length > 0, total / np.maximum(length, 1e-30), [0.0, 0.0, 1.0])
    return safe.astype(np.float32)
