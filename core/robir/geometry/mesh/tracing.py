# SPDX-License-Identifier: Apache-2.0
"""What every tracer of rays against a triangle mesh offers."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class Hits:
    """First hits of a batch of rays.

    Attributes:
        face: (N,) int32, face index, -1 where the ray leaves the scene.
        distance: (N,) float32 along the unit direction; inf where there is no hit.
        barycentric: (N, 3) float32, weights of the face's corners; zero where there is no hit.
    """

    face: NDArray[np.int32]
    distance: Floats
    barycentric: Floats


class AbstractTracer(ABC):
    """Ray queries against a fixed mesh; both sides of a triangle count."""

    @abstractmethod
    def first_hits(self, origins: Floats, directions: Floats) -> Hits:
        """Nearest surface along every ray.

        Args:
            origins: (N, 3), the mesh's frame.
            directions: (N, 3), unit.

        Returns:
            The hits, in the rays' order.
        """

    @abstractmethod
    def is_blocked(
        self, origins: Floats, directions: Floats, reach: Floats | None = None
    ) -> NDArray[np.bool_]:
        """Whether anything lies on each ray.

        Args:
            origins: (N, 3), the mesh's frame.
            directions: (N, 3), unit.
            reach: (N,) distance up to which a hit counts; unlimited if None.

        Returns:
            (N,) bool.
        """
