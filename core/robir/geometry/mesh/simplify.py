# SPDX-License-Identifier: Apache-2.0
"""Fewer triangles, and normals with creases."""

from __future__ import annotations

import fast_simplification
import numpy as np
import scipy.sparse
from numpy.typing import NDArray
from scipy.sparse.csgraph import connected_components

from robir.geometry.mesh.isosurface import compacted
from robir.geometry.mesh.tracer import EmbreeTracer
from robir.geometry.mesh.triangles import Mesh, face_geometry

CREASE = 40.0  # faces that meet at a sharper angle do not share a normal (degrees)
_SHARE_LEFT = 0.5  # share of the faces that one pass of decimation leaves
# how steeply the library raises its threshold; low keeps edges, and stalls far from the aim
_AGGRESSION = 3.0
_FEWEST = 2000  # faces that a mesh keeps however flat it is
_MOST_OFF = 0.98  # share of the vertices that must lie within a tolerance; rays miss some at edges


def decimate(mesh: Mesh, face_budget: int, tolerance: float = 0.0) -> Mesh:
    """Collapse edges by quadric error until the face budget is met.

    Garland and Heckbert 1997, "Surface simplification using quadric error metrics". The
    library collapses what lies below a threshold that rises from sweep to sweep, not the cheapest
    edge first; one call from a dense mesh spends its collapses unevenly. Calls that halve the mesh
    start over with a low threshold each. Degenerate triangles and unused vertices go.

    While the surface strays no farther than a tolerance, in the mesh's frame, it goes on to fewer
    faces: a box needs few, a ball many.
    """
    dense = mesh
    while len(mesh.faces) > face_budget:
        fewer = _collapsed(mesh, face_budget)
        is_stuck = len(fewer.faces) >= len(mesh.faces)
        mesh = fewer
        if is_stuck:  # nothing more can be collapsed
            break
    while tolerance and len(mesh.faces) > _FEWEST:
        fewer = _collapsed(mesh, _FEWEST)
        if len(fewer.faces) >= len(mesh.faces) or _strays(dense, fewer) > tolerance:
            break
        mesh = fewer
    return mesh


def _collapsed(mesh: Mesh, least: int) -> Mesh:
    """The mesh with half of its faces, or with the least number."""
    target = max(least, int(_SHARE_LEFT * len(mesh.faces)))
    vertices, faces = fast_simplification.simplify(
        mesh.vertices, mesh.faces, target_count=target, agg=_AGGRESSION
    )
    _, areas = face_geometry(vertices, faces)
    return compacted(vertices, faces[areas > 5e-13])


def _strays(dense: Mesh, mesh: Mesh) -> float:
    """Distance along normals that all but few vertices of a dense mesh lie off another."""
    return float(np.quantile(distances_off(dense, mesh), _MOST_OFF))


def distances_off(dense: Mesh, mesh: Mesh) -> NDArray[np.floating]:
    """Distance along normals of each vertex of a dense mesh from another; infinite without it."""
    tracer = EmbreeTracer(mesh.vertices, mesh.faces)
    apart = [
        tracer.first_hits(dense.vertices, sign * dense.normals).distance for sign in (1.0, -1.0)
    ]
    return np.minimum(*apart)


def thinned(mesh: Mesh, face_budget: int) -> Mesh:
    """A mesh of far too many faces in one quick pass, less even than `decimate`.

    Two million faces take 17 s of processor time; by halves, minutes.
    """
    if len(mesh.faces) <= face_budget:
        return mesh
    return compacted(
        *fast_simplification.simplify(mesh.vertices, mesh.faces, target_count=face_budget)
    )


def with_creases(mesh: Mesh) -> Mesh:
    """Split vertices where faces meet at a crease, so that each side has its own normal.

    Faces round a vertex belong together if a chain of faces leads from one to the other over angles
    below the limit; every such group gets its own copy of the vertex. Texture coordinates stay as
    they are.
    """
    faces = mesh.faces
    normals, areas = face_geometry(mesh.vertices, faces)
    one, two, shared = _edge_neighbours(faces)
    smooth = (normals[one] * normals[two]).sum(axis=1) > np.cos(np.radians(CREASE))
    one, two, shared = one[smooth], two[smooth], shared[smooth]
    # corner c of face f is node 3 f + c of a graph; corners at one vertex are joined over edges
    links_one, links_two = [], []
    for end in (0, 1):
        vertex = shared[:, end]
        links_one.append(3 * one + (faces[one] == vertex[:, None]).argmax(axis=1))
        links_two.append(3 * two + (faces[two] == vertex[:, None]).argmax(axis=1))
    link = np.concatenate(links_one), np.concatenate(links_two)
    graph = scipy.sparse.coo_matrix((np.ones(len(link[0])), link), shape=(3 * len(faces),) * 2)
    count, group = connected_components(graph, directed=False)
    vertices = np.zeros((count, 3), np.float32)
    vertices[group] = mesh.vertices[faces.ravel()]
    total = np.zeros((count, 3))
    np.add.at(total, group, np.repeat(normals * areas[:, None], 3, axis=0))
    total /= np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-30)
    return Mesh(
        vertices=vertices,
        faces=group.reshape(-1, 3).astype(np.int32),
        normals=total.astype(np.float32),
        uvs=mesh.uvs,
        uv_faces=mesh.uv_faces,
        tiles=mesh.tiles,
    )


def _edge_neighbours(
    faces: NDArray[np.int32],
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int32]]:
    """Pairs of faces that share an edge, and that edge's two vertices (K, 2)."""
    edges = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    owner = np.repeat(np.arange(len(faces)), 3)
    order = np.lexsort((edges[:, 1], edges[:, 0]))
    edges, owner = edges[order], owner[order]
    same = (edges[1:] == edges[:-1]).all(axis=1)
    return owner[:-1][same], owner[1:][same], edges[:-1][same]
