# SPDX-License-Identifier: Apache-2.0
"""Shifts of a mesh's vertices that photographs agree on, and that bend it little.

Where photographs tell nothing, a thin plate between what is known is the likeliest surface. The
least sum of correlation cost, bending and outlines is found by turns: every vertex looks for its
best shift near the smooth surface, and the smooth surface is drawn to these shifts, harder each
time (quadratic relaxation; Newcombe et al. 2011, "DTAM", eq. 11 to 14).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import scipy.sparse
from numpy.typing import NDArray
from scipy.sparse.linalg import LinearOperator, cg

from robir.geometry.mesh.isosurface import neighbour_mean, plain_mesh, taubin
from robir.geometry.mesh.tracer import EmbreeTracer
from robir.geometry.mesh.triangles import Mesh
from robir.geometry.rays import ReducedPhoto
from robir.geometry.refine.correlation import correlations, outline_shifts, pixel_size, seen_by
from robir.geometry.stereo.sweep import StereoPicture, refined_minimum

Array = NDArray[np.float64]


# rounds of Taubin smoothing before normals are taken: patches must be tilted as the surface is
_FAIR_ROUNDS = 10
_MOST_EDGE = 2.0  # length of the mesh's edges above which it is subdivided (pixels)
# how far from the smooth surface a vertex may look at first: the weight of its distance, in
# reaches squared, is one over twice this, and doubles every round
_LOOSE = 0.5
_MOST_ITERATIONS = 80  # of conjugate gradients a round; each begins where the last one ended
_REACH = 5.0  # largest shift of a vertex, pixels of the first level; weights are for this reach
_FINE_REACH = 2.0  # the same at the later levels, which start where the one before ended
_STEP = 0.5  # between the shifts that are tried, pixels
# weights of the thin plate's bending against correlation that are tried at the first level: what is
# plain needs the first, roofs and facades melt by it
_SMOOTHNESS = (640.0, 40.0)
FLAT = 3.0  # noise of a moved mesh, within which it counts as flat (pixels)
_CREASE = 0.3  # bend between neighbouring vertices at which a crease begins, pixels
_ANCHOR = 0.01  # weight of the mesh as it was, at a shift of the whole reach
_OUTLINE = 0.2  # weight of the masks' outlines, likewise, each time one runs along a vertex
_ROUNDS = 4  # rounds of search and smoothing
_MOST_VERTICES = 120_000  # vertices up to which the mesh is subdivided


@dataclass(frozen=True, slots=True, kw_only=True)
class Evidence:
    """What speaks for a vertex' shift."""

    shifts: Array  # (D,) tried, unit frame
    cost: NDArray[np.float32]  # (Nv, D), 1 less the correlation of the photographs
    outline: tuple[Array, Array]  # shifts (Nv,) that outlines ask for and their weights (Nv,)


class Judge(Protocol):
    """Photographs of one size, and what they say of meshes."""

    @property
    def photos(self) -> list[ReducedPhoto]:
        """The photographs, unit frame."""
        ...

    def keeps_relief(self, smooth: Mesh, rough: Mesh) -> bool:
        """Whether the second of two meshes, which bends more, is to go on."""
        ...

    def with_flat_parts(self, mesh: Mesh, width: float) -> Mesh:
        """A mesh whose parts within a width, unit frame, of a plane are flat."""
        ...


def refine(mesh: Mesh, judges: Sequence[Judge]) -> Mesh:
    """Move a mesh to where photographs agree, by one size of these after the other, finest last.

    Between them flat parts are made flat, so that the next one starts from sharp edges.
    """
    smoothness: tuple[float, ...] = _SMOOTHNESS
    for number, judge in enumerate(judges):
        photos, reach = judge.photos, _FINE_REACH if number else _REACH
        pictures = [StereoPicture.of(photo) for photo in photos]
        pixel = pixel_size([photo.camera for photo in photos])
        fine = _subdivided(mesh, _MOST_EDGE * pixel, _MOST_VERTICES)
        mesh = taubin(fine, _FAIR_ROUNDS)
        tracer = EmbreeTracer(mesh.vertices, mesh.faces)
        shifts = np.arange(-reach, reach + _STEP, _STEP) * pixel
        cosine = seen_by(mesh, tracer, pictures, pixel)
        agreed = correlations(mesh, pictures, cosine, shifts.astype(np.float32))
        outline = outline_shifts(mesh, tracer, photos, pixel)
        evidence = Evidence(shifts=shifts, cost=1 - agreed, outline=outline)
        tried = [
            plain_mesh(best_vertices(mesh, evidence, pixel, s), mesh.faces) for s in smoothness
        ]
        # by the finest photographs: smaller ones hardly show relief
        best = int(len(tried) > 1 and judges[-1].keeps_relief(*tried))
        mesh, smoothness = tried[best], (smoothness[best],)
        if number + 1 < len(judges):
            mesh = judge.with_flat_parts(mesh, FLAT * pixel)
    return mesh


def _subdivided(mesh: Mesh, edge: float, most: int) -> Mesh:
    """A mesh whose edges are halved until they are short enough or vertices too many."""
    import trimesh

    while 4 * len(mesh.vertices) < most:
        ends = mesh.vertices[mesh.faces[:, [0, 1]]]
        if np.median(np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1)) <= edge:
            break
        halved = trimesh.remesh.subdivide(mesh.vertices, mesh.faces)
        merged = trimesh.Trimesh(halved[0], halved[1], process=True)
        mesh = plain_mesh(np.asarray(merged.vertices), np.asarray(merged.faces))
    return mesh


def best_vertices(mesh: Mesh, evidence: Evidence, pixel: float, smoothness: float) -> Array:
    """Vertices (Nv, 3) with the least sum of cost and bending, of that weight."""
    start, normals = mesh.vertices.astype(np.float64), mesh.normals.astype(np.float64)
    shifts, cost = evidence.shifts, evidence.cost
    reach, step = _REACH * pixel, shifts[1] - shifts[0]
    plate = ThinPlate(mesh, _CREASE * pixel, _MOST_ITERATIONS)
    confidence = np.clip(cost.max(1) - cost.min(1), 0, 1)
    outline, times = evidence.outline
    at_outline = _OUTLINE * times / reach**2
    moved = np.zeros_like(start)
    for turn in range(_ROUNDS):
        hold = 2.0**turn / _LOOSE
        shift = np.einsum("nd,nd->n", moved, normals)
        total = cost + 0.5 * hold * ((shifts - shift[:, None]) / reach) ** 2
        exact = refined_minimum(total[:, None].astype(np.float32))[1][:, 0]
        found = shifts[0] + step * exact
        at_best = hold * confidence / reach**2
        pull = (at_best * found + at_outline * outline)[:, None] * normals
        moved = plate.solve(
            (start, moved),
            (at_best + at_outline, normals, pull),
            _ANCHOR / reach**2,
            smoothness / reach**2,
            has_creases=2 * turn >= _ROUNDS,
        )
    return start + moved


class ThinPlate:
    """Bending of a mesh as the sum of its vertices' Laplacians, creases allowed.

    The square root of the squared Laplacian counts beyond a width, so that an edge costs no more
    than the bend it makes (iteratively reweighted least squares).
    """

    def __init__(self, mesh: Mesh, width: float, iterations: int) -> None:
        count = len(mesh.vertices)
        self._laplacian = scipy.sparse.csr_matrix(
            scipy.sparse.identity(count) - neighbour_mean(mesh.faces, count)
        )
        self._width, self._iterations = width, iterations

    def solve(
        self,
        place: tuple[Array, Array],
        evidence: tuple[Array, Array, Array],
        anchor: float,
        smoothness: float,
        *,
        has_creases: bool,
    ) -> Array:
        """Motion (Nv, 3) of least bending, anchor and evidence.

        `place` is vertices and a first motion (Nv, 3); `evidence` weights (Nv,) of shifts along
        normals (Nv, 3), and weights times shifts times normals. With creases, sharp bends of the
        mesh as it stands are spared.
        """
        (start, moved), (weight, normals, pull) = place, evidence
        laplacian = self._laplacian
        bend = np.linalg.norm(laplacian @ (start + moved), axis=1) if has_creases else 0.0
        relaxed = np.broadcast_to(
            self._width / np.sqrt(np.square(bend) + self._width**2), len(start)
        )
        bending = laplacian.T @ scipy.sparse.diags(smoothness * relaxed) @ laplacian
        diagonal = bending.diagonal()[:, None] + weight[:, None] * normals**2 + anchor

        def apply(flat: Array) -> Array:
            motion = flat.reshape(-1, 3)
            along = (weight * np.einsum("nd,nd->n", motion, normals))[:, None] * normals
            return (bending @ motion + along + anchor * motion).ravel()

        size = 3 * len(start)
        solved, _ = cg(
            LinearOperator((size, size), matvec=apply, dtype=np.float64),
            (pull - bending @ start).ravel(),
            x0=moved.ravel(),
            rtol=1e-3,
            maxiter=self._iterations,
            M=scipy.sparse.diags(1 / diagonal.ravel()),
        )
        return solved.reshape(-1, 3)
