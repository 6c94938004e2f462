# SPDX-License-Identifier: Apache-2.0
"""Makes the user's mesh ready: texture coordinates, normals, and the copy for light."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse
from numpy.typing import NDArray
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from robir.capture.mesh_file import Detail, Given
from robir.geometry.config import GeometryConfig
from robir.geometry.given.layout import Layout, own_layout
from robir.geometry.mesh.isosurface import compacted, plain_mesh
from robir.geometry.mesh.simplify import decimate, thinned, with_creases
from robir.geometry.mesh.tiles import tile_of_faces
from robir.geometry.mesh.tracer import EmbreeTracer
from robir.geometry.mesh.triangles import Mesh
from robir.geometry.mesh.unwrap import unwrap

Array = NDArray[np.float64]

# normal map without bumps, for a tile whose materials have none
FLAT = np.full((4, 4, 3), (128, 128, 255), np.uint8)


# faces of the copy on which light is solved, over the face budget of a surface of our own
_LIGHT_FACES = 4
_THINNED = 8  # faces, over those of that copy, to which a mesh of more is thinned quickly first
# share of the faces whose normals are on the side of their front, in a mesh with a normal map
_OUTWARD = 0.99
_NORMAL_SCALE = 0.25  # distance that counts as much as two normals one unit apart (unit frame)


@dataclass(frozen=True, slots=True, kw_only=True)
class Ready:
    """The user's mesh on its way out."""

    mesh: Mesh  # unwrapped; the user's own vertices and faces unless it was decimated
    light: Mesh | None  # a copy with few faces, or None where the mesh itself has few
    # the user's, where the mesh keeps its texture coordinates: one, or one for each of its tiles;
    # else empty
    normal_maps: tuple[NDArray[np.uint8], ...]
    is_unwrapped_anew: bool  # whether its texture coordinates are not the user's
    notes: tuple[str, ...]  # sentences for the user


def made_ready(given: Given, config: GeometryConfig, warn: Callable[[str], None]) -> Ready:
    """Texture coordinates and normals for the user's mesh, and a copy for light where needed."""
    budget = _LIGHT_FACES * config.face_budget
    vertices, faces = welded(given)
    few = plain_mesh(vertices, faces)
    if is_dense := len(faces) > budget:
        whole = compacted(vertices, faces[_have_area(vertices, faces)])
        few = thinned(whole, _THINNED * budget)
    layout = own_layout(given)
    detail, notes = _detail(given, layout)
    if is_dense:
        few = with_creases(decimate(few, budget))
    if isinstance(layout, str):
        note = f"The mesh gets new texture coordinates: {layout}."
        if is_dense:
            note = f"{note[:-1]}; with them it has {len(few.faces)} faces instead of {len(faces)}."
        notes = (*notes, note)
        mesh = made = with_creases(unwrap(_rewelded(few), config.unwrap_seconds, warn))
    else:
        notes = (*notes, *layout.notes)
        made = few if is_dense else with_creases(_laid_out(few, layout))
        if detail:
            mesh = _with_own_normals(given, layout)
        elif is_dense:
            mesh = _laid_out(plain_mesh(vertices, faces), layout)
            mesh = replace(mesh, normals=_normals_of(made, mesh))
        else:
            mesh = made
    return Ready(
        mesh=mesh,
        light=None if mesh is made else made,
        normal_maps=detail,
        is_unwrapped_anew=isinstance(layout, str),
        notes=notes,
    )


def _detail(
    given: Given, layout: Layout | str
) -> tuple[tuple[NDArray[np.uint8], ...], tuple[str, ...]]:
    """The normal maps that the result can have, and a sentence where it loses the mesh's."""
    if given.detail is None or given.normals is None:
        return (), ()
    why = "it belongs to texture coordinates that are not kept"
    if not isinstance(layout, str):
        a, b, c = (given.vertices[given.faces[:, k]] for k in range(3))
        outward = np.cross(b - a, c - a)
        own = given.normals[given.faces].sum(1)
        if ((own * outward).sum(1) >= 0).mean() > _OUTWARD:
            maps = _of_tiles(given.detail, layout)
            if not isinstance(maps, str):
                return maps, ()
            why = maps
        else:
            why = "the mesh's normals point to the inside"
    return (), (f"The mesh's normal map is not passed on to the result ({why}).",)


def _of_tiles(detail: Detail, layout: Layout) -> tuple[NDArray[np.uint8], ...] | str:
    """The one normal map of each tile, or of the one texture; or why there is none."""
    # a tile whose faces have none gets a flat one; a map repeats, so one for all is each tile's
    count = len(layout.tiles)
    tile = tile_of_faces(layout.uvs, layout.uv_faces, count)
    pairs = np.unique(np.stack([tile, detail.of_face], axis=1), axis=0)
    if len(pairs) > len(np.unique(pairs[:, 0])):
        place = " in one tile" if count else ""
        return f"its materials have different ones{place}, or some have none"
    of_tile = np.full(max(1, count), -1)
    of_tile[pairs[:, 0]] = pairs[:, 1]
    return tuple(FLAT if index < 0 else detail.maps[index] for index in of_tile)


def _laid_out(mesh: Mesh, layout: Layout) -> Mesh:
    """A mesh, whose faces are the user's, with the user's layout."""
    return replace(mesh, uvs=layout.uvs, uv_faces=layout.uv_faces, tiles=layout.tiles)


def _with_own_normals(given: Given, layout: Layout) -> Mesh:
    """The user's mesh with the normals that its normal map is made for, shared where they agree."""
    assert given.normals is not None
    both = np.concatenate([given.vertices, given.normals], axis=1).astype(np.float32)
    _, first, index = np.unique(both, axis=0, return_index=True, return_inverse=True)
    faces = index.reshape(-1)[given.faces].astype(np.int32)
    mesh = plain_mesh(given.vertices[first], faces)
    normals = given.normals[first].astype(np.float32)
    return replace(_laid_out(mesh, layout), normals=normals)


def _have_area(vertices: NDArray[np.float64], faces: NDArray[np.int32]) -> NDArray[np.bool_]:
    """Faces (Nf,) that have one."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    return np.linalg.norm(np.cross(b - a, c - a), axis=1) > 0


def welded(given: Given) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Vertices (Nv, 3) that faces share wherever they have the same place, and faces (Nf, 3)."""
    _, first, index = np.unique(
        given.vertices.astype(np.float32), axis=0, return_index=True, return_inverse=True
    )
    return given.vertices[first], index.reshape(-1)[given.faces].astype(np.int32)


def _rewelded(mesh: Mesh) -> Mesh:
    """A mesh whose vertices are shared again that creases have split."""
    vertices, index = np.unique(mesh.vertices, axis=0, return_inverse=True)
    return plain_mesh(vertices, index.reshape(-1)[mesh.faces])


def _normals_of(light: Mesh, mesh: Mesh) -> NDArray[np.float32]:
    """Normals (Nv, 3) for a fine mesh's vertices, those of the coarser one where it is nearest."""
    points, query = (
        np.concatenate([one.vertices, _NORMAL_SCALE * one.normals], axis=1) for one in (light, mesh)
    )
    distance, index = cKDTree(points).query(query, k=3, eps=0.1)
    weight = 1 / (distance + 1e-4)
    total = np.einsum("nk,nkd->nd", weight, light.normals[index])
    length = np.linalg.norm(total, axis=1, keepdims=True)
    return (total / np.maximum(length, 1e-9)).astype(np.float32)


def inside_out(
    vertices: Array, faces: NDArray[np.int32], rays: tuple[Array, Array]
) -> NDArray[np.bool_]:
    """Faces (Nf,) whose back is seen where their front should be, by rays of cameras' pixels.

    Faces that are joined by edges over which they go round the same way have one outside; rays that
    meet them from behind vote against it.
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
