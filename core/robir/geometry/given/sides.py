# SPDX-License-Identifier: Apache-2.0
"""Which side of a mesh is its outside, by the side that cameras look at."""

from __future__ import annotations

import numpy as np
import scipy.sparse
from numpy.typing import NDArray
from scipy.sparse.csgraph import connected_components

from robir.geometry.mesh.tracer import EmbreeTracer

Array = NDArray[np.float64]


def inside_out(
    vertices: Array, faces: NDArray[np.int32], rays: tuple[Array, Array]
) -> NDArray[np.bool_]:
    """Faces whose back is seen where their front should be.

    Faces that are joined by edges over which they go round the same way have one outside; rays that
    meet them from behind vote against it.

    Args:
        vertices: (Nv, 3), shared by neighbouring faces.
        faces: (Nf, 3).
        rays: Origins and unit directions (N, 3) of cameras' pixels, frame of the mesh.

    Returns:
        (Nf,), those that have to be turned.
    """
    origins, directions = (part.astype(np.float32) for part in rays)
    hits = EmbreeTracer(vertices.astype(np.float32), faces).first_hits(origins, directions)
    met = hits.face >= 0
    face = hits.face[met]
    a, b, c = (vertices[faces[face, k]] for k in range(3))
    from_behind = (np.cross(b - a, c - a) * rays[1][met]).sum(1) > 0
    group = _sheets(faces)
    votes = np.bincount(group[face], np.where(from_behind, 1.0, -1.0), group.max() + 1)
    return votes[group] > 0


def _sheets(faces: NDArray[np.int32]) -> NDArray[np.int32]:
    """Number (Nf,) of the sheet of like sense that each face belongs to."""
    start, end = faces.astype(np.int64).ravel(), np.roll(faces, -1, axis=1).astype(np.int64).ravel()
    most = int(faces.max()) + 1
    forth, back = start * most + end, end * most + start
    order = np.argsort(forth)
    place = np.searchsorted(forth, back, sorter=order).clip(max=len(order) - 1)
    other = order[place]
    meets = forth[other] == back
    link = (np.flatnonzero(meets) // 3, other[meets] // 3)
    graph = scipy.sparse.coo_matrix((np.ones(len(link[0]), bool), link), shape=(len(faces),) * 2)
    return connected_components(graph, directed=False)[1]
