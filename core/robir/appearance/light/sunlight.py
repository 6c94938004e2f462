# SPDX-License-Identifier: Apache-2.0
"""Samples that are certainly lit by a sun or shaded from it, whatever the mesh errs by."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from robir.appearance.light.problem import Problem
from robir.appearance.photometry.statistics import Pairs, shadow_pairs

Floats = NDArray[np.float32]

# lobe in which a sun's visibility must be whole or nil for a point to be certain of it: 250 are 5
# degrees across, about what a mesh error of one grid cell does to a shadow
EDGE_SHARPNESS = 250.0
# share of that lobe that may be missing, or seen, of what counts as whole or nil
_EDGE_SHARE = 0.03
# cosine to a sun, of either sign, below which an error of the normals gives or takes that sun: 12
# degrees; those of a draft are 7 to 10 off on average
_GRAZING_COSINE = 0.2
_FACING_COSINE = 0.15  # cosine to a sun from which a sample is compared across its shadow


@dataclass(frozen=True, slots=True)
class Sunlight:
    """How the samples that take part (U,) stand to the suns (J,)."""

    position: Floats  # (U, 3) unit frame
    normal: Floats  # (U, 3) unit
    cosine: Floats  # (U, J) between normal and sun
    share: Floats  # (U, J) of a lobe of `EDGE_SHARPNESS` that is seen; anything where it is behind

    @classmethod
    def of(cls, problem: Problem, axes: Floats) -> Sunlight:
        """Of suns at `axes` (J, 3)."""
        scene, rows = problem.scene, problem.scene.rows
        surfels = scene.transport.surfels
        normal = surfels.normal[rows]
        sharpness = np.full(len(axes), EDGE_SHARPNESS, np.float32)
        wide = scene.sharp_transfer(axes, sharpness, rows).numpy()
        cosine = normal @ axes.T
        share = wide / np.maximum(cosine, 1e-3)
        return cls(surfels.position[rows], normal, cosine, share)

    def across_shadows(self) -> list[Pairs]:
        """Pairs across the shadow of each sun, away from its edge."""
        facing = self.cosine > _FACING_COSINE
        lit = facing & (self.share > 1 - _EDGE_SHARE)
        dark = facing & (self.share < _EDGE_SHARE)
        columns = zip(lit.T, dark.T, strict=True)
        return [shadow_pairs(self.position, self.normal, *sides) for sides in columns]

    def is_certain(self) -> Tensor:
        """Bool (U,), no error of the mesh gives or takes a sun.

        All, should that leave fewer than half.
        """
        is_part = (self.share > _EDGE_SHARE) & (self.share < 1 - _EDGE_SHARE)
        is_edge = (self.cosine > 0) & is_part
        certain = ~(is_edge | (np.abs(self.cosine) < _GRAZING_COSINE)).any(1)
        return torch.from_numpy(
            certain if 2 * certain.sum() > len(certain) else np.ones_like(certain)
        )
