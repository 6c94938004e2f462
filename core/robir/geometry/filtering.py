# SPDX-License-Identifier: Apache-2.0
"""Mesh filters that take the noise of a grid fit away and keep edges and thin parts."""

from __future__ import annotations

import numpy as np
import scipy.sparse
from numpy.typing import NDArray

from robir.geometry.mesh import Mesh
from robir.geometry.surface import plain_mesh

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


def _face_neighbours(faces: NDArray[np.int32], count: int) -> tuple[Array, Array]:
    """Pairs of different faces that share a vertex, both ways round, as two index arrays."""
    corner = np.repeat(np.arange(len(faces)), 3)
    incidence = scipy.sparse.csr_matrix(
        (np.ones(len(corner), np.int8), (corner, faces.ravel())), shape=(len(faces), count)
    )
    shared = (incidence @ incidence.T).tocoo()
    apart = shared.row != shared.col
    return shared.row[apart], shared.col[apart]


def bilateral(
    mesh: Mesh, normal_rounds: int, vertex_rounds: int, width_degrees: float = 25.0
) -> Mesh:
    """Bilateral filtering of the face normals, then vertices moved to agree with them.

    Zheng et al. 2011, "Bilateral normal filtering for mesh denoising" (local scheme); vertex
    update of Sun et al. 2007, "Fast and effective feature-preserving mesh denoising", equation 12.

    Args:
        mesh: Mesh without texture coordinates.
        normal_rounds: Rounds of normal filtering.
        vertex_rounds: Rounds of vertex motion.
        width_degrees: Angle between normals that counts as an edge.

    Returns:
        The filtered mesh.
    """
    faces, vertices = mesh.faces, mesh.vertices.astype(np.float64)
    normals, areas, centres = face_geometry(vertices, faces)
    one, two = _face_neighbours(faces, len(vertices))
    gap = np.linalg.norm(centres[one] - centres[two], axis=1)
    near = np.exp(-0.5 * (gap / gap.mean()) ** 2) * areas[two]
    width = 2.0 * np.sin(0.5 * np.radians(width_degrees))
    for _ in range(normal_rounds):
        unlike = ((normals[one] - normals[two]) ** 2).sum(axis=1)
        weight = near * np.exp(-0.5 * unlike / width**2)
        matrix = scipy.sparse.csr_matrix((weight, (one, two)), shape=(len(faces),) * 2)
        normals = matrix @ normals + areas[:, None] * normals
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
    corner = np.repeat(np.arange(len(faces)), 3)
    around = scipy.sparse.csr_matrix(
        (np.ones(len(corner)), (faces.ravel(), corner)), shape=(len(vertices), len(faces))
    )
    degree = np.maximum(np.asarray(around.sum(axis=1)), 1.0)
    for _ in range(vertex_rounds):
        centres = vertices[faces].mean(axis=1)
        reach = (normals * centres).sum(axis=1)
        # sum over the faces around a vertex of n (n . (centre - vertex))
        move = around @ (normals * reach[:, None])
        for axis in range(3):
            share = around @ (normals * normals[:, axis, None])
            move -= share * vertices[:, axis, None]
        vertices = vertices + move / degree
    return plain_mesh(vertices, faces)
