# SPDX-License-Identifier: Apache-2.0
"""Where the masks' outlines ask the surface to be."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from robir.geometry.hull import mask_distance
from robir.geometry.mesh.tracer import EmbreeTracer
from robir.geometry.mesh.triangles import Mesh
from robir.geometry.rays import Photo

_GRAZING = 0.2  # cosine between normal and view below which a vertex does
_NEAR = 3.0  # distance of an outline in the picture up to which it is the vertex' own (pixels)
# height above the surface at which rays along the view must be free on both sides (pixels)
_CLEARANCE = 2.5


def outline_shifts(
    mesh: Mesh, tracer: EmbreeTracer, photos: list[Photo], pixel: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Shifts along the normals that put vertices on the outlines they form.

    Args:
        mesh: Unit frame.
        tracer: Tracer of it.
        photos: Photographs with their masks.
        pixel: Width of a pixel there, unit frame.

    Returns:
        Mean shift (Nv,), and the number of photographs (Nv,) in whose outline a vertex lies.
    """
    total, count = np.zeros(len(mesh.vertices)), np.zeros(len(mesh.vertices))
    for photo in photos:
        camera = photo.camera
        towards = camera.position - mesh.vertices
        towards /= np.linalg.norm(towards, axis=1, keepdims=True)
        cosine = np.abs(np.einsum("nd,nd->n", towards, mesh.normals))
        rows = np.flatnonzero(cosine < _GRAZING)
        places, depth = camera.project(mesh.vertices[rows].astype(np.float64))
        size = np.array([camera.width, camera.height])
        held = (depth > 0) & (places > 1).all(1) & (places < size - 1).all(1)
        rows, depth, pixels = rows[held], depth[held], places[held].astype(int)
        away = -mask_distance(photo.coverage)[pixels[:, 1], pixels[:, 0]]
        near = np.abs(away) < _NEAR
        rows, depth, away = rows[near], depth[near], away[near]
        above = _CLEARANCE * pixel * mesh.normals[rows]
        start = (mesh.vertices[rows] + above).astype(np.float32)
        ray = towards[rows].astype(np.float32)
        alone = ~tracer.is_blocked(start, ray) & ~tracer.is_blocked(start, -ray)
        total[rows[alone]] += away[alone] * depth[alone] / camera.fx
        count[rows[alone]] += 1
    return total / np.maximum(count, 1), count
