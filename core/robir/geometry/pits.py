# SPDX-License-Identifier: Apache-2.0
"""Lone pits in a smooth surface, filled where photographs do not ask for them.

A highlight moves over a surface from photograph to photograph, and a pit below it explains that as
well as gloss does. A lone crater in an otherwise smooth surface is rare among true shapes, so it is
filled unless photographs agree better about its bottom than about the filled surface. The same
photographs are asked about both, and by medians: a highlight in a few of them counts for nothing.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import cg, spsolve

from robir.geometry.mesh.isosurface import neighbour_mean, plain_mesh
from robir.geometry.mesh.triangles import Mesh, face_geometry
from robir.geometry.prediction import Predictions

Array = NDArray[np.float64]
Rows = NDArray[np.int64]

# lengths are in the unit frame, in which the object's radius is at most 1

_SCALE = 0.08  # width of the mean curvature flow that makes the smooth surface
_BELOW = 0.005  # depth below the smooth surface from which a vertex belongs to a pit
_LEAST_DEPTH = 0.01  # of a pit that a person sees
_MOST_SIZE = 0.15  # radius of a disc of a pit's area; what is wider is shape
_MOST_LENGTH = 1.4  # of that radius: how far a crater reaches from its middle; a cleft is longer
_RIM = 0.6  # of a pit's reach: the ring around it that is looked at
# of a pit's depth: how far the ring lies off the smooth surface at most, in the mean; relief and
# creases lie farther off
_MOST_RELIEF = 0.35


class Pit(NamedTuple):
    """A crater and what would fill it."""

    own: Rows  # its vertices
    moved: Rows  # vertices that filling moves, the ring included
    places: Array  # (M, 3) where these come to lie


def without_pits(mesh: Mesh, predictions: Predictions) -> Mesh:
    """A mesh without seams, unit frame, whose lone craters are filled unless photographs ask."""
    for pit in pits(mesh):
        vertices = mesh.vertices.copy()
        vertices[pit.moved] = pit.places
        filled = plain_mesh(vertices, mesh.faces)
        spread = predictions.spread((mesh, filled), pit.own)
        if spread is not None and spread[1] <= spread[0]:
            mesh = filled
    return mesh


def pits(mesh: Mesh) -> list[Pit]:
    """Round hollows of a mesh, unit frame, in surroundings that are smooth."""
    vertices, count = mesh.vertices.astype(np.float64), len(mesh.vertices)
    mean = neighbour_mean(mesh.faces, count)
    third = np.repeat(face_geometry(vertices, mesh.faces)[1] / 3, 3)
    area = np.bincount(mesh.faces.ravel(), third).astype(np.float64)
    smooth = _flown(vertices, mean, area)
    up = plain_mesh(smooth, mesh.faces).normals.astype(np.float64)
    height = np.einsum("nd,nd->n", vertices - smooth, up)
    low = np.flatnonzero(height < -_BELOW)
    _, label = connected_components(mean[low][:, low], directed=False)
    bend = sparse.csr_matrix(sparse.identity(count) - mean)
    plate = sparse.csr_matrix(bend.T @ bend)
    found = []
    for number in range(label.max(initial=-1) + 1):
        own = low[label == number]
        depth, size = -height[own].min(), np.sqrt(area[own].sum() / np.pi)
        away = np.linalg.norm(vertices - vertices[own].mean(0), axis=1)
        reach = away[own].max()
        if depth < _LEAST_DEPTH or size > _MOST_SIZE or reach > _MOST_LENGTH * size:
            continue
        moved = _spread_to(mean, own, away < (1 + _RIM) * reach)
        ring = np.setdiff1d(moved, own)
        if not len(ring) or np.abs(height[ring]).mean() > _MOST_RELIEF * depth:
            continue
        rest = np.setdiff1d(np.arange(count), moved)
        if not mean[moved][:, rest].nnz:  # a loose piece, which nothing holds
            continue
        pull = -(plate[moved][:, rest] @ vertices[rest])
        places = spsolve(plate[moved][:, moved].tocsc(), pull)
        found.append(Pit(own=own, moved=moved, places=places))
    return found


def _flown(vertices: Array, mean: sparse.csr_matrix, area: Array) -> Array:
    """Vertices (Nv, 3) after one implicit step of mean curvature flow (Desbrun et al. 1999).

    Of their `neighbour_mean`, whose entries are the edges, and the area (Nv,) about each.
    """
    ends = mean.nonzero()
    length = np.linalg.norm(vertices[ends[0]] - vertices[ends[1]], axis=1)
    weight = sparse.csr_matrix((1 / np.maximum(length, 1e-6), ends), mean.shape)
    laplacian = sparse.diags(np.asarray(weight.sum(1)).ravel()) - weight
    step = sparse.diags(area) + _SCALE**2 / 4 * length.mean() * laplacian
    columns = [cg(step, area * own, x0=own, rtol=1e-5, maxiter=500)[0] for own in vertices.T]
    return np.stack(columns, axis=1)


def _spread_to(mean: sparse.csr_matrix, own: Rows, near: NDArray[np.bool_]) -> Rows:
    """Vertices that hang together with some, by edges between vertices that are near."""
    inside = np.zeros(len(near), bool)
    inside[own] = True
    while True:
        wider = inside | ((mean @ inside > 0) & near)
        if wider.sum() == inside.sum():
            return np.flatnonzero(inside)
        inside = wider
