# SPDX-License-Identifier: Apache-2.0
"""Makes the user's mesh ready: texture coordinates, normals, and the copy for light."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from robir.capture.mesh_file import Given
from robir.geometry.config import GeometryConfig
from robir.geometry.given.noise import without_noise
from robir.geometry.mesh.isosurface import compacted, plain_mesh
from robir.geometry.mesh.simplify import decimate, thinned, with_creases
from robir.geometry.mesh.triangles import Mesh
from robir.geometry.mesh.unwrap import rasterise_atlas, unwrap

LIGHT_FACES = 4
"""Faces of the copy on which light is solved, over the face budget of a surface of our own."""

THINNED = 8
"""Faces, over those of that copy, to which a mesh of more is thinned quickly first."""

OUTSIDE = 1e-3
"""Of the texture's side: as far as texture coordinates may leave it by rounding."""

OVERLAP = 0.03
"""Share of a layout that may lie on itself: charts' rims do."""

ATLAS = 1024
"""Texels along a side by which a layout is judged."""

OUTWARD = 0.99
"""Share of the faces whose normals are on the side of their front, in a mesh with a normal map."""

NORMAL_SCALE = 0.25
"""Distance, unit frame, that counts as much as two normals one unit apart."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Ready:
    """The user's mesh on its way out.

    Attributes:
        mesh: Unwrapped; the user's own vertices and faces unless it was decimated.
        light: A copy with few faces and without noise, or None where the mesh itself is that.
        normal_map: The user's, where the mesh keeps its texture coordinates.
        noise: Standard deviation of the vertices along their normals, unit frame.
        is_unwrapped_anew: Whether its texture coordinates are not the user's.
        notes: Sentences for the user.
    """

    mesh: Mesh
    light: Mesh | None
    normal_map: NDArray[np.uint8] | None
    noise: float
    is_unwrapped_anew: bool
    notes: tuple[str, ...]


def made_ready(given: Given, config: GeometryConfig, warn: Callable[[str], None]) -> Ready:
    """Texture coordinates and normals for the user's mesh, and a copy for light where needed.

    Args:
        given: The mesh, unit frame, its outside outward.
        config: Of the stage.
        warn: Told what is given up while unwrapping.
    """
    budget = LIGHT_FACES * config.face_budget
    vertices, faces = welded(given)
    few = plain_mesh(vertices, faces)
    if is_dense := len(faces) > budget:
        few = thinned(compacted(vertices, faces[_have_area(vertices, faces)]), THINNED * budget)
    calm, noise = without_noise(
        few.vertices.astype(np.float64) if is_dense else vertices, few.faces
    )
    notes = (_told(noise),) if noise else ()
    few = plain_mesh(calm, few.faces)
    layout, fault = _layout(given)
    detail, lost = _detail(given, fault is None)
    notes = (*notes, *lost)
    if is_dense:
        few = with_creases(decimate(few, budget))
    if fault is not None:
        note = f"The mesh gets new texture coordinates: {fault}."
        if is_dense:
            note = f"{note[:-1]}; with them it has {len(few.faces)} faces instead of {len(faces)}."
        notes = (*notes, note)
        made = with_creases(unwrap(_rewelded(few), config.unwrap_seconds, warn))
        is_copy = is_dense or len(made.faces) != len(faces)
        mesh = made if is_copy or not noise else _moved_back(made, vertices[faces])
    else:
        made = few if is_dense else with_creases(replace(few, uvs=layout, uv_faces=given.faces))
        if detail is not None:
            mesh = _with_own_normals(given, layout)
        elif is_dense:
            mesh = replace(plain_mesh(vertices, faces), uvs=layout, uv_faces=given.faces)
            mesh = replace(mesh, normals=_normals_of(made, mesh))
        else:
            mesh = _moved_back(made, vertices[faces]) if noise else made
    return Ready(
        mesh=mesh,
        light=None if mesh is made else made,
        normal_map=detail,
        noise=noise,
        is_unwrapped_anew=fault is not None,
        notes=notes,
    )


def _detail(given: Given, keeps_layout: bool) -> tuple[NDArray[np.uint8] | None, tuple[str, ...]]:
    """The normal map that the result can have, and a sentence where it loses the mesh's."""
    if given.normal_map is None or given.normals is None:
        return None, ()
    why = "it belongs to texture coordinates that are not kept"
    if keeps_layout:
        a, b, c = (given.vertices[given.faces[:, k]] for k in range(3))
        outward = np.cross(b - a, c - a)
        own = given.normals[given.faces].sum(1)
        if ((own * outward).sum(1) >= 0).mean() > OUTWARD:
            return given.normal_map, ()
        why = "the mesh's normals point to the inside"
    return None, (f"The mesh's normal map is not passed on to the result ({why}).",)


def _with_own_normals(given: Given, layout: NDArray[np.float32]) -> Mesh:
    """The user's mesh with the normals that its normal map is made for, shared where they agree."""
    assert given.normals is not None
    both = np.concatenate([given.vertices, given.normals], axis=1).astype(np.float32)
    _, first, index = np.unique(both, axis=0, return_index=True, return_inverse=True)
    faces = index.reshape(-1)[given.faces].astype(np.int32)
    mesh = plain_mesh(given.vertices[first], faces)
    normals = given.normals[first].astype(np.float32)
    return replace(mesh, normals=normals, uvs=layout, uv_faces=given.faces)


def _have_area(vertices: NDArray[np.float64], faces: NDArray[np.int32]) -> NDArray[np.bool_]:
    """Faces (Nf,) that have one."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    return np.linalg.norm(np.cross(b - a, c - a), axis=1) > 0


def _moved_back(made: Mesh, corners: NDArray[np.float64]) -> Mesh:
    """A mesh with its normals as they are and its faces' corners (Nf, 3, 3) where they were."""
    vertices = made.vertices.copy()
    vertices[made.faces] = corners
    return replace(made, vertices=vertices)


def _told(noise: float) -> str:
    return (
        f"The mesh's vertices scatter by {noise:.2%} of the object's radius; light and shading "
        "take a smoothed copy, its shape and texture coordinates stay as they are."
    )


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


def _layout(given: Given) -> tuple[NDArray[np.float32], str | None]:
    """The mesh's own texture coordinates (Nv, 2), or why they cannot be used."""
    uvs = given.uvs.astype(np.float32)
    used = uvs[np.unique(given.faces)]
    known = np.isfinite(used).all(1)
    if not known.any():
        return uvs, "it has none"
    if not known.all():
        return uvs, f"{(~known).mean():.0%} of its corners have none"
    if used.min() < -OUTSIDE or used.max() > 1 + OUTSIDE:
        return uvs, (
            f"its own lie outside 0..1 (from {used.min():.2f} to {used.max():.2f}), so that places "
            "share texels or tiles would be needed"
        )
    uvs = np.nan_to_num(uvs).clip(0, 1)
    a, b, c = (uvs[given.faces[:, k]].astype(np.float64) for k in range(3))
    (ax, ay), (bx, by) = (b - a).T, (c - a).T
    area = 0.5 * np.abs(ax * by - ay * bx).sum()
    if area < 1e-3:
        return uvs, "its own cover next to nothing of a texture"
    mesh = replace(plain_mesh(given.vertices, given.faces), uvs=uvs, uv_faces=given.faces)
    covered = float((rasterise_atlas(mesh, ATLAS)[0] >= 0).mean())
    if covered < (1 - OVERLAP) * area:
        return uvs, f"{1 - covered / area:.0%} of its own overlap, so that places share texels"
    return uvs, None


def _normals_of(light: Mesh, mesh: Mesh) -> NDArray[np.float32]:
    """Normals (Nv, 3) for a fine mesh's vertices, those of the coarser one where it is nearest."""
    points, query = (
        np.concatenate([one.vertices, NORMAL_SCALE * one.normals], axis=1) for one in (light, mesh)
    )
    distance, index = cKDTree(points).query(query, k=3, eps=0.1)
    weight = 1 / (distance + 1e-4)
    total = np.einsum("nk,nkd->nd", weight, light.normals[index])
    length = np.linalg.norm(total, axis=1, keepdims=True)
    return (total / np.maximum(length, 1e-9)).astype(np.float32)
