# SPDX-License-Identifier: Apache-2.0
"""From a distance field to triangles."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from skimage.measure import marching_cubes
from torch import Tensor

from robir.errors import QualityError
from robir.geometry.lattice import Lattice
from robir.geometry.mesh.triangles import Mesh, vertex_normals

EMPTY_UVS = np.zeros((0, 2), np.float32)
EMPTY_UV_FACES = np.zeros((0, 3), np.int32)


def plain_mesh(vertices: NDArray[np.floating], faces: NDArray[np.integer]) -> Mesh:
    """A mesh without texture coordinates, with area-weighted vertex normals.

    Args:
        vertices: (Nv, 3).
        faces: (Nf, 3), counter-clockwise seen from outside.

    Returns:
        The mesh.
    """
    vertices = np.ascontiguousarray(vertices, dtype=np.float32)
    faces = np.ascontiguousarray(faces, dtype=np.int32)
    return Mesh(
        vertices=vertices,
        faces=faces,
        normals=vertex_normals(vertices, faces),
        uvs=EMPTY_UVS,
        uv_faces=EMPTY_UV_FACES,
    )


def compacted(vertices: NDArray[np.floating], faces: NDArray[np.integer]) -> Mesh:
    """The mesh of some faces, without the vertices none of them uses."""
    used, inverse = np.unique(faces, return_inverse=True)
    return plain_mesh(vertices[used], inverse.reshape(-1, 3))


def extract(lattice: Lattice, sdf: Tensor) -> Mesh:
    """Zero level of a field by marching cubes, closed and counter-clockwise from outside.

    Args:
        lattice: Nodes.
        sdf: (N,) signed distances, negative inside.

    Returns:
        The mesh in the unit frame.

    Raises:
        QualityError: If the field has no surface.
    """
    grid = sdf.detach().cpu().view(lattice.shape).numpy().copy()
    for axis in range(3):  # closed: nothing may leave through the border
        for end in (0, -1):
            border = np.moveaxis(grid, axis, 0)[end]
            np.maximum(border, 0.5 * lattice.cell, out=border)
    if grid.min() >= 0:
        raise QualityError(
            "The geometry fit carved everything away: no surface is left. Check masks and poses."
        )
    vertices, faces, *_ = marching_cubes(
        grid, 0.0, spacing=(lattice.cell,) * 3, gradient_direction="descent"
    )
    placed = np.asarray(vertices, dtype=np.float64) + np.asarray(lattice.lower)
    return plain_mesh(placed, np.asarray(faces))
