# SPDX-License-Identifier: Apache-2.0
"""Where suns shine for sure: beside shadows, and where no error of the mesh turns them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from robir.appearance.light.problem import Problem
from robir.appearance.photometry.statistics import Pairs, shadow_pairs

Floats = NDArray[np.float32]

EDGE_SHARPNESS = 250.0
"""Lobe in which a sun's visibility must be whole or nil for a point to be certain of it: 5 degrees
across, about what a mesh error of one grid cell does to a shadow."""

GRAZING_COSINE = 0.2
"""Cosine to a sun, of either sign, below which an error of the normals gives or takes that sun: 12
degrees; those of a draft are 7 to 10 off on average."""


@dataclass(frozen=True, slots=True)
class Sunlight:
    """How the samples that take part (U,) stand to the suns (J,).

    Attributes:
        position: (U, 3) unit frame.
        normal: (U, 3) unit.
        cosine: (U, J) between normal and sun.
        share: (U, J) of a lobe of EDGE_SHARPNESS that is seen; anything where it is behind.
    """

    position: Floats
    normal: Floats
    cosine: Floats
    share: Floats

    @classmethod
    def of(cls, problem: Problem, axes: Floats) -> Sunlight:
        """Of suns at `axes` (J, 3)."""
        scene, rows = problem.scene, problem.scene.rows
        surfels = scene.transport.surfels
        normal = surfels.normal[rows]
        sharpness = np.full(len(axes), EDGE_SHARPNESS, np.float32)
        wide = scene.sharp_transfer(axes, sharpness, rows).numpy()
        cosine = normal @ axes.T
        return cls(surfels.position[rows], normal, cosine, wide / np.maximum(cosine, 1e-3))

    def across_shadows(self) -> list[Pairs]:
        """Pairs across the shadow of each sun, away from its edge."""
        facing = self.cosine > 0.15
        lit, dark = facing & (self.share > 0.97), facing & (self.share < 0.03)
        columns = zip(lit.T, dark.T, strict=True)
        return [shadow_pairs(self.position, self.normal, *sides) for sides in columns]

    def is_sure(self) -> Tensor:
        """Bool (U,), whether an error of the mesh would neither give nor take a sun.

        All, should that leave fewer than half.
        """
        is_edge = (self.cosine > 0) & (self.share > 0.03) & (self.share < 0.97)
        sure = ~(is_edge | (np.abs(self.cosine) < GRAZING_COSINE)).any(1)
        return torch.from_numpy(sure if 2 * sure.sum() > len(sure) else np.ones_like(sure))
