# SPDX-License-Identifier: Apache-2.0
"""The surfaces by stereo and by masks alone, which take the fit's place where they are better.

A fit of a field and its colours explains what it cannot otherwise by pits: highlights that move,
exposures, masks that are a pixel off, and on plain parts whatever noise there is. Depth maps and a
mesh moved to where patches agree know nothing of colours, and the visual hull knows of outlines
alone. On renderings, whose masks and poses are exact, the fit is mostly the better one; a lone
convex thing without texture is its hull. So the first level of the fit and the others are asked to
let photographs predict each other, see prediction.py, and what one bends more than another speaks
against it.
"""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from robir.capture.capture import View
from robir.geometry.config import GeometryConfig
from robir.geometry.finishing import Dense
from robir.geometry.fit.clean import largest_pieces
from robir.geometry.fit.field import Field
from robir.geometry.lattice import Sampled
from robir.geometry.mesh.isosurface import extract
from robir.geometry.mesh.smoothing import taubin
from robir.geometry.mesh.triangles import Mesh
from robir.geometry.prediction import Predictions, lead
from robir.geometry.rays import Photo, reduce_view
from robir.geometry.refine.correlation import pixel_size
from robir.geometry.refine.step import refine
from robir.geometry.stereo.surface import stereo_surface
from robir.jobs.choice import Choice

STEREO, HULL, FIELD = "by depth maps", "by masks alone", "by a fit of field and colours"


# standard errors by which a surface must lead that bends e times as much: a fit full of pits
# bends 2 to 3.4 times as much as depth maps
_BENT = 5.0
# rounds of Taubin smoothing that take the steps of the cells out of an extracted surface
_SMOOTH_ROUNDS = 5
_GRAIN = 1.5  # width of what may be noise of the refined surface (pixels)
# pixels of a photograph a face: two faces a vertex, and a vertex every other row and column
_FACE_PIXELS = 2.0
_FACE_BUDGET = 24_000  # most triangles of the result; up to that many photographs' pixels decide


def weighed(ahead: float, more: float) -> float:
    """A surface's lead over another that bends `more` times as much, in standard errors.

    Args:
        ahead: Its lead by predictions alone.
        more: How many times as much the other bends.
    """
    return ahead + _BENT * float(np.log(more))


@dataclass(frozen=True, slots=True, kw_only=True)
class Candidate:
    """A surface that may take the place of the fit.

    Attributes:
        name: As in the report.
        mesh: Smooth.
        cell: Of the lattice that it was extracted from, unit frame.
        ahead: By how many standard errors photographs predict each other better over it.
        more: How many times as much the fit bends.
        lead: Over the fit, what it bends counted, in standard errors.
    """

    name: str
    mesh: Mesh
    cell: float
    ahead: float
    more: float
    lead: float

    @property
    def words(self) -> str:
        """For the report."""
        return (
            f"{self.name} photographs predict each other better by {self.ahead:+.1f} standard "
            f"errors, and the fit bends {self.more:.1f} times as much: together {self.lead:+.1f}"
        )


class Judge:
    """What photographs say of the surfaces of fields.

    Args:
        predictions: Of the photographs, at the size that surfaces are judged at.
    """

    def __init__(self, predictions: Predictions) -> None:
        self._predictions = predictions

    def is_mirror(self, field: Field) -> bool:
        """Whether what is mirrored makes predictions better by more than a standard error."""
        return self._predictions.mirroring(smooth_surface(field)) > 1.0

    def is_better(self, field: Field, other: Field) -> bool:
        """Whether photographs predict each other better over a field, what it bends counted."""
        mesh, than = (smooth_surface(one) for one in (field, other))
        ahead = lead(self._predictions.errors(than), self._predictions.errors(mesh))
        return weighed(ahead, bending(than) / bending(mesh)) > 0


class Rival:
    """The other surfaces of a capture, made when they are asked for.

    Args:
        views: Training photographs, unit frame.
        predictions: Of the same at the size that surfaces are judged at.
        hulls: Lattice and (N,) signed distance of the visual hull, with ground if there is one, and
            as masks alone have it.
        config: Settings of the stage.

    Attributes:
        best: What goes on instead of the fit; None where that does.
        choices: What was compared, for the report; nothing if nothing was.
    """

    def __init__(
        self,
        views: tuple[View, ...],
        predictions: Predictions,
        hulls: tuple[Sampled, Sampled],
        config: GeometryConfig,
    ) -> None:
        self._views, self._predictions = views, predictions
        self._hulls, self._config = hulls, config
        self._was_asked = config.stereo_side == 0
        self.best: Candidate | None = None
        self.choices: tuple[Choice, ...] = ()

    def beats(self, field: Field) -> bool:
        """Whether one of them is better than a fit; only the first field is compared.

        Args:
            field: Of the fit's first level.
        """
        if self._was_asked:
            return False
        self._was_asked = True
        started = time.process_time()
        fitted = smooth_surface(field)
        errors, bends = self._predictions.errors(fitted), bending(fitted)
        candidates = []
        for name, (lattice, values) in ((STEREO, self._stereo()), (HULL, self._hulls[1])):
            mesh = smooth_surface(Field(lattice, values, 1))
            ahead, more = lead(errors, self._predictions.errors(mesh)), bends / bending(mesh)
            candidates.append(
                Candidate(
                    name=name,
                    mesh=mesh,
                    cell=lattice.cell,
                    ahead=ahead,
                    more=more,
                    lead=weighed(ahead, more),
                )
            )
        first = max(candidates, key=lambda candidate: candidate.lead)
        self.best = first if first.lead > 0 else None
        chosen = FIELD if self.best is None else first.name
        self.choices = (
            Choice(
                choice="surface",
                chosen=chosen,
                alternatives=tuple(name for name in (FIELD, STEREO, HULL) if name != chosen),
                why="; ".join(candidate.words for candidate in candidates)
                + "; the fit's first level was compared",
                cost_seconds=time.process_time() - started,
            ),
        )
        return self.best is not None

    def _stereo(self) -> Sampled:
        # nothing is restored where masks show something that no depth does: guessed masks hold
        # background between arm and body, and stereo is right to carve it
        side = self._config.stereo_side
        compared = [reduce_view(view, side) for view in self._views]
        return stereo_surface(compared, self._hulls[0])


def refined(best: Candidate, views: tuple[View, ...], config: GeometryConfig) -> Dense:
    """A surface moved to where patches agree, where photographs then predict each other better.

    Args:
        best: The surface.
        views: Training photographs, unit frame.
        config: Settings of the stage.
    """
    mesh = best.mesh
    photos = [reduce_view(view, max(config.refine_sides)) for view in views]
    moved = refine(mesh, views, config.refine_sides)
    # at the size that it was refined by: half of it does not show what it gained
    predictions = Predictions(photos)
    if lead(predictions.errors(mesh), predictions.errors(moved)) > 0:
        mesh = moved
    grain, faces = resolved(photos, config)
    return Dense(mesh, min(best.cell, grain), faces)


def resolved(photos: list[Photo], config: GeometryConfig) -> tuple[float, int]:
    """What photographs resolve: the width of what may be noise, and the faces they deserve."""
    pixels = float(np.median([photo.coverage.sum() for photo in photos]))
    grain = _GRAIN * pixel_size([photo.camera for photo in photos])
    return grain, int(min(max(config.face_budget, pixels / _FACE_PIXELS), _FACE_BUDGET))


def smooth_surface(field: Field) -> Mesh:
    """Surface of a field, freed of loose pieces and of the steps of its cells."""
    whole = extract(field.lattice, field.sdf)
    return taubin(largest_pieces(whole), _SMOOTH_ROUNDS)


def bending(mesh: Mesh) -> float:
    """Total absolute mean curvature of a surface over the root of its area, of a sphere 3.54.

    The sum over edges of length times dihedral angle, halved (Cohen-Steiner and Morvan 2003).

    Args:
        mesh: Of any frame and unit.
    """
    import trimesh

    surface = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    ends = surface.vertices[surface.face_adjacency_edges]
    lengths = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    return float(0.5 * (lengths @ surface.face_adjacency_angles) / np.sqrt(surface.area))
