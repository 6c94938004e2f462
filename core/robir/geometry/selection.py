# SPDX-License-Identifier: Apache-2.0
"""Model selection: the fit, depth maps or the visual hull, by how well photographs are predicted.

A fit of a field and its colours explains what it cannot otherwise by pits: highlights that move,
exposures, masks that are a pixel off, and on plain parts whatever noise there is. Depth maps and a
mesh moved to where patches agree know nothing of colours, and the visual hull knows of outlines
alone. On renderings, whose masks and poses are exact, the fit is mostly the better one; a lone
convex thing without texture is its hull. So photographs predict each other over each of them, see
prediction.py, and what one bends more than another speaks against it. The better of depth maps and
hull is compared as refined: before, it is what a mesh of cells is, and the fit is smooth.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cached_property
from typing import NamedTuple

import numpy as np

from robir.capture.capture import View
from robir.geometry.config import GeometryConfig
from robir.geometry.flat_parts import with_flat_parts
from robir.geometry.lattice import Sampled
from robir.geometry.mesh.isosurface import extract, largest_pieces, taubin
from robir.geometry.mesh.triangles import Mesh
from robir.geometry.prediction import Predictions, lead
from robir.geometry.rays import ReducedPhoto, reduce_view
from robir.geometry.refine.correlation import pixel_size
from robir.geometry.refine.step import FLAT, refine
from robir.geometry.stereo.fusion import WELL_INSIDE, stereo_surfaces
from robir.jobs.context import Choice
from robir.workers import meanwhile, side_by_side

STEREO, HULL, FIELD = "by depth maps", "by masks alone", "by a fit of field and colours"

# standard errors by which a surface must lead that bends e times as much: a fit full of pits
# bends 2 to 3.4 times as much as depth maps
_BENT = 5.0
# lead, bending counted, from which a refined surface keeps its relief: the house has 5.9, eleven
# round and plain things have -5.8 to 2.7, and are better without
_RELIEF = 4.0
# rounds of Taubin smoothing that take the steps of the cells out of an extracted surface
_SMOOTH_ROUNDS = 5
# by how much a surface may lie behind the fit and yet overtake it: refinement brings -0.4 to 5.7
_WITHIN_REACH = 4.0
# lead from which it does: scissors that the fit has better come to 0.4, what is better 2.8 and more
_OVERTAKES = 2.0
# standard errors by which a surface that fills guessed masks may lie behind one that need not
_BELIEVED = 3.0
_GUESSED_WITHIN = 4.0  # distance from the outline of a guessed mask beyond which it is (pixels)
# photographs must be so many times as large as a size to show less at it: none is looked at twice
_COARSER = 1.25
_GRAIN = 1.5  # width of what may be noise of a fit, where cells are wider (pixels)
# pixels of a photograph a face: two faces a vertex, and a vertex every other row and column
_FACE_PIXELS = 2.0
_FACE_BUDGET = 24_000  # most triangles of the result; up to that many photographs' pixels decide


class Dense(NamedTuple):
    """A surface as it was extracted."""

    mesh: Mesh  # without texture coordinates, unit frame
    widths: tuple[float, ...]  # within which of a plane it counts as flat, unit frame
    faces: int  # triangles that it deserves
    is_smooth: bool = False  # so that teeth along flat parts would show


class PhotographJudge:
    """Photographs of one size, unit frame, and what they say of meshes by predicting each other."""

    def __init__(self, photos: list[ReducedPhoto]) -> None:
        self.photos, self.predictions = photos, Predictions(photos)

    @property
    def pixel(self) -> float:
        """Width of a pixel at the middle of the scene, unit frame."""
        return pixel_size([photo.camera for photo in self.photos])

    def keeps_relief(self, smooth: Mesh, rough: Mesh) -> bool:
        """Whether photographs ask for a rough surface, what it bends more counted."""
        return self.lead_over(smooth, rough) > _RELIEF

    def with_flat_parts(self, mesh: Mesh, width: float, *, follows: bool = True) -> Mesh:
        """See `flat_parts`."""
        return with_flat_parts(mesh, width, self.predictions, follows=follows)

    def lead_over(self, other: Mesh, mesh: Mesh) -> float:
        """By how many standard errors a mesh leads another, what it bends counted."""
        ahead = lead(self.predictions.errors(other), self.predictions.errors(mesh))
        return weighed(ahead, bending(other) / bending(mesh))


class SurfaceCandidate(NamedTuple):
    """A surface that may take the place of the fit."""

    name: str  # as in the report
    dense: Dense  # smooth
    ahead: float  # by how many standard errors photographs predict each other better over it
    more: float  # how many times as much the fit bends

    @property
    def lead(self) -> float:
        """Over the fit, what it bends counted, in standard errors."""
        return weighed(self.ahead, self.more)

    @property
    def words(self) -> str:
        """For the report."""
        return (
            f"{self.name} photographs predict each other better by {self.ahead:+.1f} standard "
            f"errors, and the fit bends {self.more:.1f} times as much: together {self.lead:+.1f}"
        )


def weighed(ahead: float, more: float) -> float:
    """Lead by predictions, in standard errors, over what bends `more` times as much."""
    return ahead + _BENT * float(np.log(more))


class Selection:
    """Compares surfaces by photographs, unit frame, and selects the one that goes on.

    `hulls` are the visual hull, with ground if there is one, and as masks alone have it; `photos`
    the views at the size that surfaces are compared at; `holds_masks` says whether masks were
    given, so that the object is wherever they show it. `best` goes on instead of the fit, None
    where that does; `choices` are what was compared, for the report.
    """

    def __init__(
        self,
        views: tuple[View, ...],
        photos: list[ReducedPhoto],
        hulls: tuple[Sampled, Sampled],
        config: GeometryConfig,
        *,
        holds_masks: bool,
    ) -> None:
        self._views, self._coarse = views, PhotographJudge(photos)
        self._hulls, self._config, self._holds_masks = hulls, config, holds_masks
        self._is_done = config.stereo_side == 0
        self._stereo: Callable[[], Sampled] | None = None  # what gives the depth maps begun
        self.best: SurfaceCandidate | None = None
        self.choices: tuple[Choice, ...] = ()

    @contextmanager
    def prepared(self) -> Iterator[None]:
        """Find beside the block what `has_better` compares with."""
        if self._is_done:
            yield
            return
        with meanwhile(self._by_depth_maps) as self._stereo:
            yield
        self._stereo = None  # it holds the photographs

    def _by_depth_maps(self) -> Sampled:
        compared = self._reduced(self._config.stereo_side)
        within = WELL_INSIDE if self._holds_masks else _GUESSED_WITHIN
        free, held = stereo_surfaces(compared, self._hulls[0], within=within)
        if self._holds_masks or held is free:
            return held
        ahead = self._coarse.lead_over(smooth_surface(free), smooth_surface(held))
        return held if ahead > -_BELIEVED else free

    @property
    def _longest(self) -> int:
        """Longest side of the photographs (pixels)."""
        return max(max(view.camera.width, view.camera.height) for view in self._views)

    def _reduced(self, side: int) -> list[ReducedPhoto]:
        return side_by_side(lambda view: reduce_view(view, side), self._views)

    @cached_property
    def judge(self) -> PhotographJudge:
        """The photographs as large as surfaces are refined by."""
        return PhotographJudge(self._reduced(max(self._config.refine_sides)))

    def is_mirror(self, surface: Sampled) -> bool:
        """Whether what is mirrored makes predictions better by more than a standard error."""
        return self._coarse.predictions.mirroring(smooth_surface(surface)) > 1.0

    def is_better(self, surface: Sampled, other: Sampled, least: float = 0.0) -> bool:
        """Whether photographs predict each other better over a surface, what it bends counted.

        By more than `least`, in standard errors; below zero they need only not speak against it.
        """
        return self._coarse.lead_over(smooth_surface(other), smooth_surface(surface)) > least

    def has_better(
        self, field: Sampled, finished: Callable[[Sampled], Sampled] = lambda surface: surface
    ) -> bool:
        """Whether depth maps or hull are better than a fit; only the first level is compared.

        `finished` is what is done to the surface of depth maps first.
        """
        if self._is_done:
            return False
        self._is_done = True
        started = time.process_time()
        fitted = smooth_surface(field)
        predictions = self._coarse.predictions
        errors, bends = predictions.errors(fitted), bending(fitted)

        def candidate(name: str, dense: Dense) -> SurfaceCandidate:
            ahead = lead(errors, predictions.errors(dense.mesh))
            return SurfaceCandidate(name, dense, ahead, bends / bending(dense.mesh))

        by_depth_maps = self._stereo or self._by_depth_maps
        surfaces = {STEREO: finished(by_depth_maps()), HULL: self._hulls[1]}
        candidates = {
            name: candidate(
                name, Dense(smooth_surface(one), (one.lattice.cell,), self._config.face_budget)
            )
            for name, one in surfaces.items()
        }
        first = max(candidates.values(), key=lambda candidate: candidate.lead)
        if first.lead > -_WITHIN_REACH:
            first = candidate(first.name, self._refined(first.dense))
            candidates[first.name] = first
        self.best = first if first.lead > _OVERTAKES else None
        chosen = FIELD if self.best is None else first.name
        self.choices = (
            Choice(
                choice="surface",
                chosen=chosen,
                alternatives=tuple(name for name in (FIELD, STEREO, HULL) if name != chosen),
                why="; ".join(candidate.words for candidate in candidates.values())
                + "; the fit's first level was compared, and the first of the others as refined",
                cost_seconds=time.process_time() - started,
            ),
        )
        return self.best is not None

    def _refined(self, dense: Dense) -> Dense:
        """A surface moved to where patches agree, if photographs and its bending speak for that."""
        finest = max(self._config.refine_sides)
        judges = [
            self.judge if side == finest else PhotographJudge(self._reduced(side))
            for side in self._config.refine_sides
            if side == finest or side * _COARSER <= self._longest
        ]
        moved = refine(dense.mesh, judges)
        # at the size that it was refined by: half of it does not show what it gained
        is_better = self.judge.lead_over(dense.mesh, moved) > 0
        pixels = float(np.median([photo.coverage.sum() for photo in self.judge.photos]))
        faces = int(min(max(self._config.face_budget, pixels / _FACE_PIXELS), _FACE_BUDGET))
        widths = tuple(sorted({FLAT * judge.pixel for judge in judges}))
        return Dense(moved if is_better else dense.mesh, widths, faces, is_smooth=True)

    def of_fit(self, surface: Sampled) -> Dense:
        """The surface that a fit has come to."""
        width = min(surface.lattice.cell, _GRAIN * self.judge.pixel)
        return Dense(smooth_surface(surface), (width,), self._config.face_budget)


def smooth_surface(surface: Sampled) -> Mesh:
    """Zero level of a field, freed of loose pieces and of the steps of its cells."""
    return taubin(largest_pieces(extract(*surface)), _SMOOTH_ROUNDS)


def bending(mesh: Mesh) -> float:
    """Total absolute mean curvature of a surface over the root of its area, of a sphere 3.54.

    The sum over edges of length times dihedral angle, halved (Cohen-Steiner and Morvan 2003).
    """
    import trimesh

    surface = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    ends = surface.vertices[surface.face_adjacency_edges]
    lengths = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    return float(0.5 * (lengths @ surface.face_adjacency_angles) / np.sqrt(surface.area))
