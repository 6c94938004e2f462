# SPDX-License-Identifier: Apache-2.0
"""Normals of a surface from photographs, freed of its grain.

Such a surface is right to a pixel, but its normals are off by a pixel over the distance of its
vertices, and reflections double that. So normals are averaged over their surroundings, and those
that face elsewhere count little (bilateral filtering of normals, Jones et al. 2003 and Zheng et al.
2011).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from robir.geometry.mesh.triangles import Mesh
from robir.steps import Step
from robir.transport.baked import Transport
from robir.transport.surfels import Surfels
from robir.workers import num_workers

Floats = NDArray[np.float32]

CHUNK = 8192  # normals that are averaged at a time; each takes some kilobytes

_REACH = 0.08  # distance that is averaged over (unit frame)
# angle between normals at which they count a third: twice the error of a good one (degrees)
_EDGE = 25.0
_NUM_SAMPLES = 128  # samples that are averaged at most, the nearest


@dataclass(frozen=True, slots=True, kw_only=True)
class LitSurface:
    """What light falls on."""

    mesh: Mesh  # that textures belong to, unit frame
    transport: Transport  # baked, with the samples of the surface


def smoothed(position: Floats, normal: Floats, surfels: Surfels) -> Floats:
    """Normals (N, 3), at positions (N, 3), averaged over the samples about them."""
    tree = cKDTree(surfels.position)
    known = np.concatenate([surfels.normal, np.zeros((1, 3), np.float32)])
    result = np.empty_like(normal)
    for start in range(0, len(position), CHUNK):
        part = slice(start, start + CHUNK)
        _, near = tree.query(
            position[part], _NUM_SAMPLES, distance_upper_bound=_REACH, workers=num_workers()
        )
        others, own = known[near], normal[part]
        cosine = np.einsum("nkd,nd->nk", others, own).clip(-1, 1)
        weight = np.exp(-((np.arccos(cosine) / np.radians(_EDGE)) ** 2))
        # the own normal counts as one: there is always something to average
        total = np.einsum("nk,nkd->nd", weight, others) + own
        result[part] = total / np.linalg.norm(total, axis=1, keepdims=True)
    return result


def _smooth_normals(state: LitSurface) -> LitSurface:
    mesh, surfels = state.mesh, state.transport.surfels
    own = smoothed(surfels.position, surfels.normal, surfels)
    vertices = smoothed(mesh.vertices.astype(np.float32), mesh.normals, surfels)
    return replace(
        state,
        mesh=replace(mesh, normals=vertices),
        transport=replace(state.transport, surfels=replace(surfels, normal=own)),
    )


# what is done to the surface before it is asked for light
SURFACE: tuple[Step[LitSurface], ...] = (
    Step(
        name="smooth-normals",
        purpose="frees the surface's normals of their grain",
        source="bilateral filtering of normals (Jones et al. 2003, Zheng et al. 2011)",
        run=_smooth_normals,
    ),
)
