# SPDX-License-Identifier: Apache-2.0
"""From a dense surface to the mesh that carries a texture, as steps."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

from robir.geometry.config import GeometryConfig
from robir.geometry.mesh.facets import flattened
from robir.geometry.mesh.simplify import decimate, with_creases
from robir.geometry.mesh.triangles import Mesh
from robir.geometry.mesh.unwrap import unwrap
from robir.steps import Course, Step


class Dense(NamedTuple):
    """A surface as it was extracted.

    Attributes:
        mesh: Without texture coordinates, unit frame.
        grain: Width of what may be noise of it, unit frame.
        faces: Triangles that it deserves.
    """

    mesh: Mesh
    grain: float
    faces: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Finishing:
    """A surface on its way to a mesh.

    Attributes:
        dense: As it was extracted.
        mesh: As far as it has got.
        config: The stage's configuration.
        warn: Takes a sentence for the user.
    """

    dense: Dense
    mesh: Mesh
    config: GeometryConfig
    warn: Callable[[str], None]


def finished(
    dense: Dense, config: GeometryConfig, warn: Callable[[str], None], course: Course
) -> Mesh:
    """Carry the steps out.

    Args:
        dense: Extracted surface.
        config: The stage's configuration.
        warn: Takes a sentence for the user.
        course: Of the stage's steps.

    Returns:
        The unwrapped mesh.
    """
    start = Finishing(dense=dense, mesh=dense.mesh, config=config, warn=warn)
    return course.carry_out(FINISHING, start).mesh


def _flatten(state: Finishing) -> Finishing:
    return replace(state, mesh=flattened(state.mesh, state.dense.grain))


def _decimate(state: Finishing) -> Finishing:
    return replace(state, mesh=decimate(state.mesh, state.dense.faces))


def _unwrap(state: Finishing) -> Finishing:
    seconds = state.config.unwrap_seconds
    return replace(state, mesh=unwrap(state.mesh, seconds, state.warn))


def _crease(state: Finishing) -> Finishing:
    return replace(state, mesh=with_creases(state.mesh))


FINISHING: tuple[Step[Finishing], ...] = (
    Step(
        name="facets",
        purpose="makes large flat parts flat, with sharp edges between them",
        source="RANSAC for planes (Schnabel et al. 2007), seeds at even steps of area",
        run=_flatten,
    ),
    Step(
        name="decimate",
        purpose="leaves the triangles that photographs resolve",
        source="quadric error metrics (Garland and Heckbert 1997)",
        run=_decimate,
        is_on_trial=False,
    ),
    Step(
        name="unwrap",
        purpose="gives texture coordinates",
        source="xatlas",
        run=_unwrap,
        is_on_trial=False,
    ),
    Step(
        name="creases",
        purpose="gives each side of a sharp edge normals of its own",
        source="smoothing groups by angle",
        run=_crease,
    ),
)
"""What is done to the surface that was chosen, in this order."""
