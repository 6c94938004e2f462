# SPDX-License-Identifier: Apache-2.0
"""From a distance field to triangles, and what frees these of a grid's noise and loose pieces."""

from __future__ import annotations

import numpy as np
import scipy.sparse
from numpy.typing import NDArray
from scipy.sparse.csgraph import connected_components
from skimage.measure import marching_cubes
from torch import Tensor

from robir.errors import QualityError
from robir.geometry.lattice import Lattice
from robir.geometry.mesh.triangles import Mesh, face_geometry, vertex_normals

_LEAST_SHARE = 0.02  # pieces with less than this share of the largest piece's area are removed


def plain_mesh(vertices: NDArray[np.floating], faces: NDArray[np.integer]) -> Mesh:
    """A mesh without texture coordinates, with area-weighted vertex normals."""
    vertices = np.ascontiguousarray(vertices, dtype=np.float32)
    faces = np.ascontiguousarray(faces, dtype=np.int32)
    return Mesh(
        vertices=vertices,
        faces=faces,
        normals=vertex_normals(vertices, faces),
        uvs=np.zeros((0, 2), np.float32),
        uv_faces=np.zeros((0, 3), np.int32),
    )


def compacted(vertices: NDArray[np.floating], faces: NDArray[np.integer]) -> Mesh:
    """The mesh of some faces, without the vertices none of them uses."""
    used, inverse = np.unique(faces, return_inverse=True)
    return plain_mesh(vertices[used], inverse.reshape(-1, 3))


def extract(lattice: Lattice, sdf: Tensor) -> Mesh:
    """Zero level of a field (N,) by marching cubes, closed and counter-clockwise from outside.

    `QualityError` if the field has no surface.
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


def largest_pieces(mesh: Mesh) -> Mesh:
    """Keep the pieces that are not small against the largest one."""
    faces = mesh.faces
    graph = scipy.sparse.coo_matrix(
        (np.ones(2 * len(faces)), (faces[:, [0, 1]].ravel(), faces[:, [1, 2]].ravel())),
        shape=(len(mesh.vertices),) * 2,
    )
    _, piece = connected_components(graph, directed=False)
    of_face = piece[faces[:, 0]]
    _, areas = face_geometry(mesh.vertices, faces)
    area = np.bincount(of_face, weights=areas)
    return compacted(mesh.vertices, faces[area[of_face] >= _LEAST_SHARE * area.max()])


def neighbour_mean(faces: NDArray[np.int32], count: int) -> scipy.sparse.csr_matrix:
    """Matrix from values of vertices to the means over the vertices' neighbours."""
    rows = faces[:, [0, 1, 2, 1, 2, 0]].ravel()
    columns = faces[:, [1, 2, 0, 0, 1, 2]].ravel()
    matrix = scipy.sparse.csr_matrix((np.ones(len(rows)), (rows, columns)), shape=(count, count))
    matrix.data[:] = 1.0
    degree = np.asarray(matrix.sum(axis=1)).ravel()
    return scipy.sparse.diags(1.0 / np.maximum(degree, 1.0)) @ matrix


def taubin(mesh: Mesh, rounds: int) -> Mesh:
    """Taubin smoothing: pairs of a shrinking and a growing Laplacian step.

    Taubin 1995, "A signal processing approach to fair surface design", lambda 0.5, mu -0.53.
    """
    mean = neighbour_mean(mesh.faces, len(mesh.vertices))
    vertices = mesh.vertices.astype(np.float64)
    for step in (0.5, -0.53) * rounds:
        vertices += step * (mean @ vertices - vertices)
    return plain_mesh(vertices, mesh.faces)
