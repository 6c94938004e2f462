# SPDX-License-Identifier: Apache-2.0
"""The surface by stereo, which takes the place of the fit where it is the better one.

A fit of a field and its colours explains what it cannot otherwise by pits: highlights that move,
exposures, masks that are a pixel off. Depth maps and a mesh moved to where patches agree know
nothing of colours. On renderings, whose masks and poses are exact, the fit is the better one. So
the first level of the fit and the stereo surface are both asked to let photographs predict each
other, see prediction.py, and what the one bends more than the other speaks against it.
"""

from __future__ import annotations

import time
from functools import cached_property

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

STEREO, FIELD = "by depth maps", "by a fit of field and colours"

BENT = 5.0
"""Standard errors by which a surface must lead that bends e times as much: a fit full of pits bends
2 to 3.4 times as much as depth maps."""

SMOOTH_ROUNDS = 5
"""Rounds of Taubin smoothing that take the steps of the cells out of an extracted surface."""

GRAIN_PIXELS = 1.5
"""Width of what may be noise of the refined surface, pixels."""

FACE_PIXELS = 2.0
"""Pixels of a photograph a face: two faces a vertex, and a vertex every other row and column."""


class Rival:
    """The stereo surface of a capture, made when it is asked for.

    Args:
        views: Training photographs, unit frame.
        photos: The same at the size that surfaces are judged at.
        hull: Lattice and (N,) signed distance of the visual hull, with ground if there is one.
        config: Settings of the stage.

    Attributes:
        leads: Whether it goes on instead of the fit.
        choices: What was compared, for the report; nothing if nothing was.
    """

    def __init__(
        self,
        views: tuple[View, ...],
        photos: list[Photo],
        hull: Sampled,
        config: GeometryConfig,
    ) -> None:
        self._views, self._photos, self._hull, self._config = views, photos, hull, config
        self._was_asked = config.stereo.image_side == 0
        self.leads = False
        self.choices: tuple[Choice, ...] = ()

    def beats(self, field: Field) -> bool:
        """Whether it is the better one; only the first field is compared.

        Args:
            field: Of the fit's first level.
        """
        if self._was_asked:
            return False
        self._was_asked = True
        started = time.process_time()
        surfaces = smooth_surface(field), self._mesh
        ahead = lead(*(self._predictions.errors(mesh) for mesh in surfaces))
        more = bending(surfaces[0]) / bending(surfaces[1])
        self.leads = ahead + BENT * np.log(more) > 0
        names = (STEREO, FIELD) if self.leads else (FIELD, STEREO)
        self.choices = (
            Choice(
                choice="surface",
                chosen=names[0],
                alternatives=names[1:],
                why="over depth maps photographs predict each other better by "
                f"{ahead:+.1f} standard errors than over the first level of the fit, which bends "
                f"{more:.1f} times as much: worth {BENT * np.log(more):+.1f}",
                cost_seconds=time.process_time() - started,
            ),
        )
        return self.leads

    @cached_property
    def _predictions(self) -> Predictions:
        return Predictions(self._photos)

    @cached_property
    def _field(self) -> Field:
        # nothing is restored where masks show something that no depth does: guessed masks hold
        # background between arm and body, and stereo is right to carve it
        side = self._config.stereo.image_side
        compared = [reduce_view(view, side) for view in self._views]
        return Field(*stereo_surface(compared, self._hull, self._config.stereo), 1)

    @cached_property
    def _mesh(self) -> Mesh:
        return smooth_surface(self._field)

    def refined(self) -> Dense:
        """The stereo surface, refined where that lets photographs predict each other better."""
        config, mesh = self._config, self._mesh
        photos = [reduce_view(view, max(config.refine.image_sides)) for view in self._views]
        moved = refine(mesh, self._views, config.refine)
        # at the size that it was refined by: half of it does not show what it gained
        predictions = Predictions(photos)
        if lead(predictions.errors(mesh), predictions.errors(moved)) > 0:
            mesh = moved
        grain, faces = resolved(photos, config)
        return Dense(mesh, min(self._field.lattice.cell, grain), faces)


def resolved(photos: list[Photo], config: GeometryConfig) -> tuple[float, int]:
    """What photographs resolve: the width of GRAIN_PIXELS pixels, and the faces it deserves."""
    pixels = float(np.median([photo.coverage.sum() for photo in photos]))
    grain = GRAIN_PIXELS * pixel_size([photo.camera for photo in photos])
    most = config.refine.face_budget
    return grain, int(min(max(config.face_budget, pixels / FACE_PIXELS), most))


def smooth_surface(field: Field) -> Mesh:
    """Surface of a field, freed of loose pieces and of the steps of its cells."""
    return taubin(largest_pieces(extract(field.lattice, field.sdf)), SMOOTH_ROUNDS)


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
