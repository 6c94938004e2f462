# SPDX-License-Identifier: Apache-2.0
"""Cameras that were found from photographs alone, brought to where the user's mesh is.

Such cameras have a frame and a unit that mean nothing, so the mesh stays where the user has it and
the capture moves: what comes of it stands, light and cameras with it, in the mesh's own frame.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from robir.capture.bounds import MARGIN, enclosing_sphere
from robir.capture.capture import Bounds, Capture
from robir.capture.mesh_file import Given
from robir.errors import CaptureError
from robir.geometry.config import GeometryConfig
from robir.geometry.given.placing import (
    COARSE_SIDE,
    FINE_SIDE,
    FITS,
    Agreement,
    Outlines,
    better_place,
    covering,
    poor_fit,
    show_fit,
)
from robir.maths.similarity import Similarity

Array = NDArray[np.float64]


# from which cameras are believed to be where they were brought; meshes of other objects reach 0.8
_ALIGNS = 0.85


@dataclass(frozen=True, slots=True, kw_only=True)
class Aligned:
    """A capture that was brought to a mesh."""

    capture: Capture  # in the mesh's frame and unit; if it was moved, its bounds are the mesh's
    # what brings the capture as it was to there, or None where it stood there already
    frame: Similarity | None
    agreement: Agreement  # of the mesh's outlines with the masks
    notes: tuple[str, ...]  # sentences for the user


def aligned(given: Given, capture: Capture, config: GeometryConfig, picture: Path) -> Aligned:
    """Bring cameras in a frame of ours to where their photographs show the mesh.

    `CaptureError` if outlines and masks agree nowhere, or with the mesh's mirror image only.
    """
    used = given.vertices[np.unique(given.faces)]
    centre, radius = enclosing_sphere(used)
    # about the middle of the unit sphere, for a scan may be far from its origin
    from_unit = _from_unit(centre, radius)
    vertices = from_unit.inverse(given.vertices)
    tracer = covering(vertices, given.faces)
    if not config.fit_mesh:
        now = Outlines(capture.train, FINE_SIDE).of(tracer, from_unit)
        if now.share >= FITS:
            return Aligned(capture=capture, frame=None, agreement=now, notes=())
    to_capture = _from_unit(*Outlines(capture.train, COARSE_SIDE).sphere())
    views = capture.moved(to_capture.inverse).train
    place, then = better_place(from_unit.inverse(used), tracer, views, None)
    if then.share < _ALIGNS or np.linalg.det(place.turn) < 0:
        show_fit(tracer, (place,), views, picture)
        raise CaptureError(_why_not(place, then, picture))
    show_fit(tracer, (place,), views, picture)
    frame = to_capture.after(place).after(from_unit.inverse).inverse
    told = (
        "The photographs' cameras were found and brought to the mesh, which stays where it is: its "
        f"outlines and the masks share {then.share:.1%}, see {picture}."
    )
    bounds = Bounds(centre=centre, radius=MARGIN * radius, origin="the mesh")
    return Aligned(
        capture=replace(capture.moved(frame), bounds=bounds),
        frame=frame,
        agreement=then,
        notes=(told, *poor_fit(then)),
    )


def _from_unit(centre: Array, radius: float) -> Similarity:
    """What brings the unit sphere onto another."""
    return Similarity(turn=np.eye(3), scale=radius, shift=centre)


def _why_not(place: Similarity, then: Agreement, picture: Path) -> str:
    """Why no cameras could be brought to a mesh, and what to do."""
    if np.linalg.det(place.turn) < 0 and then.share >= _ALIGNS:
        return (
            "the mesh is mirrored: no turn makes it fit the photographs, and its mirror image "
            f"shares {then.share:.0%} with the masks; export it without a negative scale; "
            f"{picture} shows the mirror image over them"
        )
    return (
        "the photographs' cameras cannot be brought to the mesh: of what its outlines or the masks "
        f"have, both have {then.share:.0%} at best, of {_ALIGNS:.0%} that it takes. {picture} "
        "shows it. Is it the mesh of this object, whole, and without what it stands on? Are the "
        "masks right (--masks)? Else give photographs with cameras in the mesh's frame, as the "
        "program exports them that made it"
    )
