# SPDX-License-Identifier: Apache-2.0
"""Where suns shine for sure: beside shadows, and where no error of the mesh turns them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from robir.appearance.config import AppearanceConfig
from robir.appearance.light.problem import Problem
from robir.appearance.photometry.statistics import Pairs, shadow_pairs

Floats = NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class Sunlight:
    """How the samples that take part (U,) stand to the suns (J,).

    Attributes:
        position: (U, 3) unit frame.
        normal: (U, 3) unit.
        cosine: (U, J) between normal and sun.
        share: (U, J) of a lobe of `edge_sharpness` that is seen; anything where it is behind.
        config: What is sure, and which pairs there are.
    """

    position: Floats
    normal: Floats
    cosine: Floats
    share: Floats
    config: AppearanceConfig

    @classmethod
    def of(cls, problem: Problem, axes: Floats) -> Sunlight:
        """Of suns at `axes` (J, 3)."""
        scene, rows = problem.scene, problem.scene.rows
        surfels = scene.transport.surfels
        normal = surfels.normal[rows]
        edge_sharpness = scene.config.light.sunlight.edge_sharpness
        sharpness = np.full(len(axes), edge_sharpness, np.float32)
        wide = scene.sharp_transfer(axes, sharpness, rows).numpy()
        cosine = normal @ axes.T
        share = wide / np.maximum(cosine, 1e-3)
        return cls(surfels.position[rows], normal, cosine, share, scene.config)

    def across_shadows(self) -> list[Pairs]:
        """Pairs across the shadow of each sun, away from its edge."""
        config, statistics = self.config.light.sunlight, self.config.photometry.statistics
        facing = self.cosine > config.facing_cosine
        lit = facing & (self.share > 1 - config.edge_share)
        dark = facing & (self.share < config.edge_share)
        columns = zip(lit.T, dark.T, strict=True)
        return [shadow_pairs(self.position, self.normal, *sides, statistics) for sides in columns]

    def is_sure(self) -> Tensor:
        """Bool (U,), whether an error of the mesh would neither give nor take a sun.

        All, should that leave fewer than half.
        """
        config = self.config.light.sunlight
        is_part = (self.share > config.edge_share) & (self.share < 1 - config.edge_share)
        is_edge = (self.cosine > 0) & is_part
        sure = ~(is_edge | (np.abs(self.cosine) < config.grazing_cosine)).any(1)
        return torch.from_numpy(sure if 2 * sure.sum() > len(sure) else np.ones_like(sure))
