# SPDX-License-Identifier: Apache-2.0
"""Removal of pieces the photographs do not support."""

from __future__ import annotations

import numpy as np
import scipy.sparse
from scipy.sparse.csgraph import connected_components

from robir.geometry.mesh import Mesh
from robir.geometry.surface import compacted

LEAST_SHARE = 0.02
"""Pieces with less than this share of the largest piece's area are removed."""


def largest_pieces(mesh: Mesh) -> Mesh:
    """Keep the pieces that are not small against the largest one."""
    faces = mesh.faces
    graph = scipy.sparse.coo_matrix(
        (np.ones(2 * len(faces)), (faces[:, [0, 1]].ravel(), faces[:, [1, 2]].ravel())),
        shape=(len(mesh.vertices),) * 2,
    )
    _, piece = connected_components(graph, directed=False)
    corners = mesh.vertices[faces].astype(np.float64)
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    of_face = piece[faces[:, 0]]
    area = np.bincount(of_face, weights=np.linalg.norm(cross, axis=1))
    return compacted(mesh.vertices, faces[area[of_face] >= LEAST_SHARE * area.max()])
