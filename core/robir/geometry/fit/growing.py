# SPDX-License-Identifier: Apache-2.0
"""A coarse mesh of the surface while the field is fitted, to look at; never changes the fit."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from robir.capture.capture import Bounds
from robir.errors import QualityError
from robir.geometry.lattice import Lattice, Sampled, resample
from robir.geometry.mesh.isosurface import extract
from robir.geometry.mesh.simplify import thinned
from robir.geometry.mesh.triangles import Mesh
from robir.jobs.paths import replacing

MAX_FACES = 5000
"""Most triangles; more would show no more while the surface still moves."""

CELLS = 40
"""Cells along the longest side; of a ball that makes twice `MAX_FACES`, thinned in 0.01 CPU-s."""

_MARGIN = 3
"""Cells of the fit's lattices beyond the object's box on every side."""


def save_growing(path: Path, surface: Sampled, bounds: Bounds) -> None:
    """Write the zero level as .npz, atomically; a field without one leaves the file as it is.

    The arrays are stored as they are: `vertices` (V, 3) float32 in the capture's frame and unit,
    `faces` (F, 3) int32, counter-clockwise seen from outside, at most `MAX_FACES` of them.

    Args:
        path: File to replace.
        surface: The field, unit frame.
        bounds: The sphere that is the unit sphere there, capture frame.
    """
    mesh = coarse(surface)
    if mesh is None:
        return
    vertices = bounds.radius * mesh.vertices.astype(np.float64) + bounds.centre
    with replacing(path) as temporary, temporary.open("wb") as file:
        np.savez(file, vertices=vertices.astype(np.float32), faces=mesh.faces)


def coarse(surface: Sampled) -> Mesh | None:
    """The zero level of a field by few triangles, unit frame; None where there is none yet."""
    lattice, values = surface
    inset = _MARGIN * lattice.cell
    few = Lattice.around(np.asarray(lattice.lower) + inset, lattice.upper - inset, CELLS)
    sampled = resample(values.detach(), lattice, few)
    if not bool(sampled.isfinite().all()):  # the fit itself will say so
        return None
    try:
        mesh = thinned(extract(few, sampled), MAX_FACES)
    except QualityError:
        return None
    return mesh if 0 < len(mesh.faces) <= MAX_FACES else None
