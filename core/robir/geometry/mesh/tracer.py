# SPDX-License-Identifier: Apache-2.0
"""Rays against a triangle mesh: Embree on the CPU, torch elsewhere."""

from __future__ import annotations

import numpy as np
from embreex import rtcore_scene
from embreex.mesh_construction import TriangleMesh
from numpy.typing import NDArray

from robir.geometry.mesh.tracing import AbstractTracer, Floats, Hits


class EmbreeTracer(AbstractTracer):
    """Embree's bounding volumes, on the CPU."""

    def __init__(self, vertices: Floats, faces: NDArray[np.int32]) -> None:
        """Build the acceleration structure.

        Args:
            vertices: (Nv, 3), any frame; rays are in the same frame.
            faces: (Nf, 3).
        """
        self._scene = rtcore_scene.EmbreeScene()
        corners = np.ascontiguousarray(vertices.astype(np.float32)[faces])
        self._mesh = TriangleMesh(self._scene, corners)

    def first_hits(self, origins: Floats, directions: Floats) -> Hits:
        """Nearest surface along every ray; see AbstractTracer."""
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
        """Whether anything lies on each ray; see AbstractTracer."""
        origins = np.ascontiguousarray(origins, np.float32)
        directions = np.ascontiguousarray(directions, np.float32)
        if reach is None:
            hit = self._scene.run(origins, directions, query="OCCLUDED")
        else:
            reach = np.ascontiguousarray(reach, np.float32)
            hit = self._scene.run(origins, directions, reach, query="OCCLUDED")
        return hit >= 0


def make_tracer(vertices: Floats, faces: NDArray[np.int32], device: str) -> AbstractTracer:
    """The fastest tracer for a device: Embree on "cpu", torch on any other."""
    if device == "cpu":
        return EmbreeTracer(vertices, faces)
    # Not above: torch takes seconds to load and Embree does without it.
    from robir.geometry.mesh.torch_tracer import TorchTracer

    return TorchTracer(vertices, faces, device)
