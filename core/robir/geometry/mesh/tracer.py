# SPDX-License-Identifier: Apache-2.0
"""Rays against a triangle mesh, by Embree (Wald et al. 2014).

On the processor also where a graphics card does the rest: a traversal in torch took ten times as
long there.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from embreex import rtcore_scene
from embreex.mesh_construction import TriangleMesh
from numpy.typing import NDArray

Floats = NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class Hits:
    """First hits of a batch of rays."""

    face: NDArray[np.int32]  # (N,) int32, face index, -1 where the ray leaves the scene
    distance: Floats  # (N,) float32 along the unit direction; inf where there is no hit
    barycentric: Floats  # (N, 3) float32, weights of the face's corners; zero where there is no hit


class EmbreeTracer:
    """Ray queries against a fixed mesh; both sides of a triangle count."""

    def __init__(self, vertices: Floats, faces: NDArray[np.int32]) -> None:
        """Build the bounding volumes of vertices (Nv, 3), in the rays' frame, and faces (Nf, 3)."""
        self._scene = rtcore_scene.EmbreeScene()
        corners = np.ascontiguousarray(vertices.astype(np.float32)[faces])
        self._mesh = TriangleMesh(self._scene, corners)

    def first_hits(self, origins: Floats, directions: Floats) -> Hits:
        """Nearest surface along rays, origins and unit directions (N, 3) in the mesh's frame."""
        found = self._scene.run(
            np.ascontiguousarray(origins, np.float32),
            np.ascontiguousarray(directions, np.float32),
            output=1,
        )
        face = found["primID"].astype(np.int32)
        missed = face < 0
        u, v = found["u"], found["v"]
        barycentric = np.stack([1 - u - v, u, v], axis=1)
        barycentric[missed] = 0
        distance = np.where(missed, np.inf, found["tfar"]).astype(np.float32)
        return Hits(face, distance, barycentric)

    def is_blocked(
        self, origins: Floats, directions: Floats, reach: Floats | None = None
    ) -> NDArray[np.bool_]:
        """Whether anything lies on each ray (N,), up to a distance (N,) or anywhere."""
        origins = np.ascontiguousarray(origins, np.float32)
        directions = np.ascontiguousarray(directions, np.float32)
        if reach is None:
            hit = self._scene.run(origins, directions, query="OCCLUDED")
        else:
            reach = np.ascontiguousarray(reach, np.float32)
            hit = self._scene.run(origins, directions, reach, query="OCCLUDED")
        return hit >= 0
