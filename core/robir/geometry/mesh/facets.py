# SPDX-License-Identifier: Apache-2.0
"""Flat parts of a surface, found and made flat, so that they meet in sharp edges.

A fit to photographs leaves noise of a fraction of a cell everywhere, marching cubes cuts every
edge off, and smoothing rounds it. Where a large part of the surface lies within that noise of a
plane, the plane is the likelier surface: its vertices move onto it, and those near two planes onto
their common line. The width of the noise is the unit of all lengths here.
The search follows Schnabel et al. 2007, "Efficient RANSAC for point-cloud shape detection", with
seeds at even steps of area instead of random ones. A curved surface also lies near its tangent
plane, but it leaves that plane smoothly on all sides, by which it is told apart.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import scipy.sparse
from numpy.typing import NDArray
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import spsolve

from robir.geometry.mesh.isosurface import neighbour_mean, plain_mesh
from robir.geometry.mesh.triangles import Mesh, face_geometry

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


_NEAR = 0.75  # largest distance of a facet's own vertices from its plane (widths)
_TILT = 20.0  # largest angle between their normals and the plane's (degrees)
_LEAST_SIDE = 12.0  # a facet is at least as large as a square of this side (widths)
_LEAST_PIECE = 0.25  # least area of a connected piece of a facet, in such squares
_MOST_FACETS = 30  # facets that are looked for
_MOST_FAILURES = 30  # candidates that may fail before the search ends
_LONG = 0.9  # share of the edges that are shorter than what counts as an edge's length
_SEEDS = 150  # vertices that propose a plane
_VOTERS = 5000  # vertices that vote on each
# how often normals are averaged with the neighbours' for the search, where edges are a width long
_NORMAL_PASSES = 6
_FITS = 4  # how often a plane is fitted to its members
_ROUGH = 0.33  # largest root mean square distance of the facet's vertices from the plane (widths)
_BOWED = 0.12  # largest root mean square height of a paraboloid fitted to these distances (widths)
# most area, against the facet's, of what leaves its plane nearby while its normal is still near
# the plane's: more of that means a curved surface
_ESCAPE = 0.5
_ESCAPE_RINGS = 6.0  # how far from the facet that is looked for (widths)
_ESCAPE_TILT = 45.0  # largest angle between its normals and the plane's (degrees)
# distance from the plane within which vertices are moved onto it: the cut-off edges (widths)
_REACH = 1.7
_REACH_RINGS = 3.0  # and within this of the facet's own vertices, along the surface (widths)
_REACH_COSINE = 0.5  # between their normals and the plane's, at least
_REACH_PASSES = 2  # how often these normals are averaged with the neighbours'
_LIMIT = 2.0  # vertices that would move further than this stay (widths)
_EVENED = 8  # how often membership is averaged with the neighbours' before the majority has it
_FOLLOWING = 2.0  # how far from what is moved the rest is drawn along (widths)
_SAME_SIDE = 0.5  # of planes whose normals have a larger cosine, only the nearest claims a vertex


@dataclass(frozen=True, slots=True, kw_only=True)
class Facet:
    """A flat part of a mesh."""

    normal: Array  # (3,) unit, outward
    offset: float  # of the plane from the origin along the normal
    members: Mask  # (Nv,) the vertices that make it up

    def height(self, points: Array) -> Array:
        """Signed distance of points (P, 3) from the plane."""
        return points @ self.normal - self.offset


class _Skin:
    """A dense mesh with noise of a width, prepared for the search."""

    def __init__(self, mesh: Mesh, width: float) -> None:
        self.width = width
        self.tilt = np.cos(np.radians(_TILT))
        self.vertices = mesh.vertices.astype(np.float64)
        self._mean = neighbour_mean(mesh.faces, len(mesh.vertices))
        self._own_normals = mesh.normals.astype(np.float64)
        _, areas = face_geometry(self.vertices, mesh.faces)
        self.areas = np.bincount(
            mesh.faces.ravel(), weights=np.repeat(areas / 3.0, 3), minlength=len(mesh.vertices)
        )
        self._edges = np.concatenate([mesh.faces[:, [0, 1]], mesh.faces[:, [1, 2]]])
        self.least = (_LEAST_SIDE * width) ** 2
        ends = self.vertices[self._edges]
        lengths = np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1)
        self._edge = float(np.quantile(lengths, _LONG))
        self.normals = self.smooth_normals(self.rings(_NORMAL_PASSES))

    def smooth_normals(self, passes: int) -> Array:
        """Unit vertex normals (Nv, 3), averaged with the neighbours' so many times."""
        normals = self._own_normals
        for _ in range(passes):
            normals = normals + self._mean @ normals
        return normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)

    def grown(self, members: Mask, rings: int) -> Mask:
        """The vertices within so many edges of some."""
        for _ in range(rings):
            members = members | (self._mean @ members.astype(np.float64) > 0)
        return members

    def evened(self, members: Mask) -> Mask:
        """Members by the majority of their neighbours, without teeth along the border."""
        share = members.astype(np.float64)
        for _ in range(_EVENED):
            share = 0.5 * (share + self._mean @ share)
        return share > 0.5

    def rings(self, widths: float) -> int:
        """Rings of neighbours that reach so many widths far, and so many edges at least."""
        return int(np.ceil(widths * max(1.0, self.width / self._edge)))

    def followed(self, motion: Array, moved: Mask, drawn: Mask) -> Array:
        """The motion (Nv, 3) of some vertices, and that of others that are drawn along smoothly."""
        inner = self._mean[drawn]
        matrix = scipy.sparse.identity(int(drawn.sum())) - inner[:, drawn]
        followed = np.zeros_like(motion)
        followed[moved] = motion[moved]
        followed[drawn] = spsolve(scipy.sparse.csc_matrix(matrix), inner[:, moved] @ motion[moved])
        return followed

    def spread(self, wanted: Mask, count: int) -> NDArray[np.int64]:
        """At most `count` of the wanted vertices at even steps of area."""
        chosen = np.flatnonzero(wanted)
        total = np.cumsum(self.areas[chosen])
        steps = (np.arange(count) + 0.5) / count * total[-1]
        return chosen[np.unique(np.searchsorted(total, steps).clip(max=len(chosen) - 1))]

    def near(self, free: Mask, normal: Array, offset: float) -> Mask:
        """The free vertices that belong to a plane, without its small pieces."""
        inside = free & (np.abs(self.vertices @ normal - offset) < _NEAR * self.width)
        inside &= self.normals @ normal > self.tilt
        links = self._edges[inside[self._edges].all(axis=1)]
        count = len(self.vertices)
        graph = scipy.sparse.coo_matrix((np.ones(len(links)), links.T), shape=(count, count))
        pieces, piece = connected_components(graph, directed=False)
        size = np.bincount(piece, weights=self.areas * inside, minlength=pieces)
        return inside & (size[piece] >= _LEAST_PIECE * self.least)


def find_facets(mesh: Mesh, width: float) -> list[Facet]:
    """The large flat parts of a dense mesh with noise of a width, largest support first."""
    return _search(_Skin(mesh, width))


def _search(skin: _Skin) -> list[Facet]:
    """See `find_facets`."""
    most, failures = _MOST_FACETS, 0
    free = np.ones(len(skin.vertices), bool)
    found: list[Facet] = []
    while len(found) < most and skin.areas[free].sum() >= skin.least:
        seed = _best_seed(skin, free)
        facet = _settled(skin, free, seed)
        free &= ~facet.members
        if skin.areas[facet.members].sum() >= skin.least and _is_flat(skin, facet):
            found.append(facet)
        else:
            free[seed] = False
            failures += 1
            if failures == _MOST_FAILURES:
                break
    return found


def _best_seed(skin: _Skin, free: Mask) -> int:
    """The free vertex whose tangent plane most of the free surface lies near to."""
    voters = skin.spread(free, _VOTERS)
    seeds = skin.spread(free, _SEEDS)
    normals, points = skin.normals[seeds], skin.vertices[seeds]
    height = skin.vertices[voters] @ normals.T - (points * normals).sum(axis=1)
    agrees = np.abs(height) < _NEAR * skin.width
    agrees &= skin.normals[voters] @ normals.T > skin.tilt
    return int(seeds[agrees.sum(axis=0).argmax()])


def _settled(skin: _Skin, free: Mask, seed: int) -> Facet:
    """The facet about a seed, its plane fitted to its members again and again."""
    normal = skin.normals[seed]
    offset = float(skin.vertices[seed] @ normal)
    members = skin.near(free, normal, offset)
    for _ in range(_FITS):
        if skin.areas[members].sum() < skin.least:
            break
        weight = skin.areas[members, None]
        middle = (weight * skin.vertices[members]).sum(axis=0) / weight.sum()
        apart = skin.vertices[members] - middle
        _, _, axes = np.linalg.svd((weight * apart).T @ apart)
        fitted = axes[2] * np.sign(axes[2] @ normal)
        if fitted @ normal < skin.tilt:
            break
        normal, offset = fitted, float(middle @ fitted)
        members = skin.near(free, normal, offset)
    return Facet(normal=normal, offset=offset, members=members)


def _is_flat(skin: _Skin, facet: Facet) -> bool:
    """Whether a facet is flat up to noise and ends at edges: not a piece of something curved."""
    weight = skin.areas[facet.members]
    height = facet.height(skin.vertices[facet.members])
    variance = (weight * height**2).sum() / weight.sum()
    if np.sqrt(variance) > _ROUGH * skin.width:
        return False
    apart = skin.vertices[facet.members] - skin.vertices[facet.members].mean(axis=0)
    _, _, axes = np.linalg.svd(facet.normal[None])
    u, v = (apart @ axes[1:].T).T / np.abs(apart).max()
    terms = np.stack([np.ones_like(u), u, v, u * u, u * v, v * v], axis=1)
    root = np.sqrt(weight)
    bow, *_ = np.linalg.lstsq(terms * root[:, None], height * root, rcond=None)
    bowed = (weight * (terms @ bow) ** 2).sum() / weight.sum()
    if np.sqrt(bowed) > _BOWED * skin.width:
        return False
    about = skin.grown(facet.members, skin.rings(_ESCAPE_RINGS)) & ~facet.members
    about &= np.abs(facet.height(skin.vertices)) > _NEAR * skin.width
    about &= skin.normals @ facet.normal > np.cos(np.radians(_ESCAPE_TILT))
    return bool(skin.areas[about].sum() < _ESCAPE * weight.sum())


class Flattened(NamedTuple):
    """A mesh with flat parts."""

    mesh: Mesh  # the same faces
    # (Nv,) number of the facet that each vertex belongs to or is drawn along by; -1 for none
    part: NDArray[np.int64]


def flattened(mesh: Mesh, width: float, facets: list[Facet], *, follows: bool) -> Flattened:
    """The mesh with these facets of it made flat, and sharp where two of them meet.

    What adjoins follows if asked for, so that no teeth are left on a smooth surface.
    """
    skin = _Skin(mesh, width)
    part = np.full(len(mesh.vertices), -1)
    if not facets:
        return Flattened(mesh, part)
    claims = _claims(skin, facets)
    if follows:
        claims = np.stack([skin.evened(claimed) for claimed in claims])
    placed = skin.vertices.copy()
    for _ in range(12):  # alternating projections end on the planes' intersection
        for facet, claimed in zip(facets, claims, strict=True):
            placed[claimed] -= facet.height(placed[claimed])[:, None] * facet.normal
    motion = placed - skin.vertices
    is_moved = claims.any(axis=0) & (np.linalg.norm(motion, axis=1) <= _LIMIT * width)
    for number, claimed in enumerate(claims):
        part[claimed & is_moved] = number
    following = skin.rings(_FOLLOWING) if follows else 0
    for number, claimed in enumerate(claims):
        part[skin.grown(claimed & is_moved, following) & (part < 0)] = number
    drawn = (part >= 0) & ~is_moved
    followed = skin.vertices + skin.followed(motion, is_moved, drawn)
    return Flattened(plain_mesh(followed, mesh.faces), part)


def _claims(skin: _Skin, facets: list[Facet]) -> Mask:
    """The vertices (F, Nv) that are moved onto each plane; those of two lie where planes meet."""
    normals = skin.smooth_normals(_REACH_PASSES)
    distance = np.abs(np.stack([facet.height(skin.vertices) for facet in facets]))
    near = np.stack([skin.grown(facet.members, skin.rings(_REACH_RINGS)) for facet in facets])
    near &= distance < _REACH * skin.width
    near &= np.stack([normals @ facet.normal > _REACH_COSINE for facet in facets])
    claims = near.copy()
    for one, facet in enumerate(facets):
        for two, other in enumerate(facets):
            if one != two and facet.normal @ other.normal > _SAME_SIDE:
                claims[one] &= ~(near[two] & (distance[two] < distance[one]))
    return claims
