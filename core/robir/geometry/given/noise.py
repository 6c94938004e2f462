# SPDX-License-Identifier: Apache-2.0
"""The noise of a scan's vertices, measured by the mesh itself, and a copy without it.

A surface goes on where a vertex' neighbours lead; noise contradicts them. Twice the difference from
the neighbours' mean, taken along the normal, leaves next to nothing of a surface, and of noise that
is each vertex' own a known share. Such noise also makes neighbours differ in opposite senses, to a
degree that the triangles fix, and shape makes them differ in like ones; so the correlation between
neighbours tells how much of what is left is noise. A mesh without noise is left alone by that.

Normals are then averaged about each face, over as few faces as the noise asks for, and with faces
beyond an edge counting less, seen by what the last round had averaged: Wang et al. 2015, "Rolling
guidance normal filter for geometric processing". Vertices follow them as in Sun et al. 2007, "Fast
and effective feature-preserving mesh denoising". What was taken away has to be noise once more: a
mesh of few faces errs beside its surface as well, but there neighbours are moved to like sides.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.stats import norm

from robir.geometry.mesh.smoothing import face_geometry, neighbour_mean
from robir.geometry.mesh.triangles import vertex_normals

Array = NDArray[np.float64]

BLOCK = 1 << 15
"""Faces that are averaged at a time."""


_CALM = 0.25  # share of the surface by which noise is measured: where it is calmest
# standard errors of the correlation by which it must be below zero, and standard deviations
# beyond which a vertex counts as that far off
_SURE = 3.0
_LEFT = 0.05  # error of a normal that the averaging leaves (radians)
_LIKE = 0.3  # difference of two averaged normals that counts as one standard deviation
_ROUNDS = 5  # of averaging; an edge that the first has blurred is back after some
_NEIGHBOURS = 64  # faces at most that are averaged
_STEPS = 20  # in which vertices follow the normals
_FARTHEST = 3.0  # standard deviations of the noise by which a vertex moves at most
# correlation between neighbours from which what was taken away is shape. It is below 0.06 for
# scans with noise, and above 0.2 for meshes that were decimated far.
_SHAPE = 0.1


def without_noise(vertices: Array, faces: NDArray[np.int32]) -> tuple[Array, float]:
    """Vertices (Nv, 3) of a mesh without its noise, and the noise that it has.

    Args:
        vertices: (Nv, 3), shared by neighbouring faces.
        faces: (Nf, 3), each with an area.

    Returns:
        The very vertices and 0 where the mesh has no noise, or where it cannot be told from shape;
        else moved ones, and the standard deviation of noise along the normal, in their unit.
    """
    noise = vertex_noise(vertices, faces)
    if noise == 0.0:
        return vertices, 0.0
    calm = calmed(vertices, faces, noise)
    normals = vertex_normals(vertices.astype(np.float32), faces)
    taken = ((calm - vertices) * normals).sum(1)
    one, two = taken[_edges(faces)].T
    power = (one**2 + two**2).sum() / 2
    is_shape = (one * two).sum() > _SHAPE * power
    return (vertices, 0.0) if is_shape else (calm, noise)


def vertex_noise(vertices: Array, faces: NDArray[np.int32]) -> float:
    """Standard deviation of the noise of vertices along their normals, in their unit.

    Args:
        vertices: (Nv, 3), shared by neighbouring faces.
        faces: (Nf, 3).

    Returns:
        0 where the mesh shows none.
    """
    normals = vertex_normals(vertices.astype(np.float32), faces).astype(np.float64)
    count = len(vertices)
    apart = neighbour_mean(faces, count) - scipy.sparse.identity(count)
    twice = (apart @ apart).tocsr()
    gain = np.sqrt(np.asarray(twice.multiply(twice).sum(axis=1)).ravel())
    left = apart @ (normals * (apart @ vertices)).sum(1) / np.maximum(gain, 1e-9)
    _, areas, _ = face_geometry(vertices, faces)
    weight = np.bincount(faces.ravel(), np.repeat(areas, 3), count)
    order = np.argsort(np.abs(left))
    total = np.cumsum(weight[order])
    # what that share of a normal distribution stays below, in standard deviations
    normal = round(float(norm.ppf(0.5 + 0.5 * _CALM)), 4)
    calm = np.abs(left)[order[np.searchsorted(total, _CALM * total[-1])]] / normal
    edges = _edges(faces)
    one, two = edges.T
    bounded = left.clip(-_SURE * calm, _SURE * calm)
    both = weight[one] + weight[two]
    power = (both * (bounded[one] ** 2 + bounded[two] ** 2)).sum() / 2
    if power <= 0:
        return 0.0
    found = (both * bounded[one] * bounded[two]).sum() / power
    if found > -_SURE / np.sqrt(np.count_nonzero(weight)):
        return 0.0
    product = np.asarray(twice[one].multiply(twice[two]).sum(axis=1)).ravel()
    expected = (both * product / (gain[one] * gain[two])).sum() / both.sum()
    return float(calm * np.sqrt(np.clip(found / min(expected, -1e-9), 0.0, 1.0)))


def calmed(vertices: Array, faces: NDArray[np.int32], noise: float) -> Array:
    """Vertices (Nv, 3) without noise, none further from its old place than noise reaches.

    Args:
        vertices: (Nv, 3), shared by neighbouring faces.
        faces: (Nf, 3).
        noise: Standard deviation of the vertices along their normals, above 0.
    """
    normals = _averaged(vertices, faces, noise)
    moved = vertices.copy()
    corner = faces.ravel()
    used = np.maximum(np.bincount(corner, minlength=len(vertices)), 1)[:, None]
    for _ in range(_STEPS):
        away = moved[faces].mean(axis=1)[:, None] - moved[faces]
        pull = (away * normals[:, None]).sum(-1)[..., None] * normals[:, None]
        pull = pull.reshape(-1, 3)
        moved += np.stack([np.bincount(corner, x, len(vertices)) for x in pull.T], 1) / used
    step = moved - vertices
    length = np.linalg.norm(step, axis=1, keepdims=True)
    return vertices + step * np.minimum(1.0, _FARTHEST * noise / np.maximum(length, 1e-30))


def _averaged(vertices: Array, faces: NDArray[np.int32], noise: float) -> Array:
    """Normals (Nf, 3) of faces, averaged as far as noise asks for it.

    Of white noise with one value an area a, a Gaussian average of width s leaves the slope an error
    of noise * sqrt(a / (4 pi)) / s^2.
    """
    own, areas, centres = face_geometry(vertices, faces)
    of_vertex = np.bincount(faces.ravel(), np.repeat(areas / 3, 3), len(vertices))
    share = of_vertex[faces].mean(axis=1)
    width = np.sqrt(noise * np.sqrt(share / (4 * np.pi)) / _LEFT).clip(1e-9)
    tree = cKDTree(centres)
    near = []
    for start in range(0, len(own), BLOCK):
        some = slice(start, start + BLOCK)
        distance, index = tree.query(centres[some], k=min(_NEIGHBOURS, len(own)))
        weight = areas[index] * np.exp(-0.5 * (distance / width[some, None]) ** 2)
        near.append((some, index.astype(np.int32), weight.astype(np.float32)))
    guide = own
    for number in range(_ROUNDS):
        averaged = np.empty_like(own)
        for some, index, weight in near:
            if number:
                apart = ((guide[index] - guide[some, None]) ** 2).sum(-1)
                like = np.exp(-0.5 * apart / _LIKE**2)
            else:  # nothing is known of edges yet, but a thin part has another side
                like = (own[index] * own[some, None]).sum(-1) > 0
            averaged[some] = np.einsum("fk,fkd->fd", weight * like, own[index])
        guide = averaged / np.maximum(np.linalg.norm(averaged, axis=1, keepdims=True), 1e-30)
    return guide


def _edges(faces: NDArray[np.int32]) -> NDArray[np.int32]:
    """Pairs of vertices (E, 2), each edge once."""
    return np.unique(np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1), axis=0)
