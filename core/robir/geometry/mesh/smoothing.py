# SPDX-License-Identifier: Apache-2.0
"""Mesh filter that takes the noise of a grid fit away and keeps thin parts."""

from __future__ import annotations

import numpy as np
import scipy.sparse
from numpy.typing import NDArray

from robir.geometry.mesh.isosurface import plain_mesh
from robir.geometry.mesh.triangles import Mesh

Array = NDArray[np.float64]


def neighbour_mean(faces: NDArray[np.int32], count: int) -> scipy.sparse.csr_matrix:
    """Matrix that takes vertex values to the means over the vertices' neighbours.

    Args:
        faces: (Nf, 3).
        count: Number of vertices.

    Returns:
        (count, count); the row of a vertex without neighbours is zero.
    """
    rows = faces[:, [0, 1, 2, 1, 2, 0]].ravel()
    columns = faces[:, [1, 2, 0, 0, 1, 2]].ravel()
    matrix = scipy.sparse.csr_matrix((np.ones(len(rows)), (rows, columns)), shape=(count, count))
    matrix.data[:] = 1.0
    degree = np.asarray(matrix.sum(axis=1)).ravel()
    return scipy.sparse.diags(1.0 / np.maximum(degree, 1.0)) @ matrix


def taubin(mesh: Mesh, rounds: int, strength: NDArray[np.floating] | float = 1.0) -> Mesh:
    """Taubin smoothing: pairs of a shrinking and a growing Laplacian step.

    Taubin 1995, "A signal processing approach to fair surface design", lambda .5, mu -.53.

    Args:
        mesh: Mesh without texture coordinates.
        rounds: Number of pairs of steps.
        strength: Share of each vertex' motion that is applied, scalar or (Nv,), in [0, 1].

    Returns:
        The smoothed mesh.
    """
    mean = neighbour_mean(mesh.faces, len(mesh.vertices))
    vertices = mesh.vertices.astype(np.float64)
    share = np.broadcast_to(np.asarray(strength, dtype=np.float64), len(vertices))[:, None]
    for _ in range(rounds):
        for step in (0.5, -0.53):
            vertices += step * share * (mean @ vertices - vertices)
    return plain_mesh(vertices, mesh.faces)


def face_geometry(vertices: Array, faces: NDArray[np.int32]) -> tuple[Array, Array, Array]:
    """Unit normals (Nf, 3), areas (Nf,) and centres (Nf, 3) of triangles."""
    corners = vertices[faces]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(cross, axis=1)
    return cross / np.maximum(length, 1e-30)[:, None], 0.5 * length, corners.mean(axis=1)
