# SPDX-License-Identifier: Apache-2.0
"""Samples that are certainly lit by a sun or shaded from it, whatever the mesh errs by."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from robir.appearance.light.problem import Problem
from robir.appearance.photometry.statistics import STEP_WIDTH, Pairs, shadow_pairs

# difference in hue, beyond the step common to all pairs, at which two samples hardly are one
# material (log albedo)
ALIKE_HUE = 0.1
ALIKE_BRIGHTNESS = 0.35  # the same in brightness. The fields of a board are 0.8 apart (log albedo)
# error of the irradiance that mesh and bounces leave, over its mean: what hardly any light reaches
# has an albedo that nobody knows
LIGHT_ERROR = 0.05


def irradiance_doubt(irradiance: Tensor) -> Tensor:
    """One standard deviation (N,) of the logarithm of an irradiance (N, 3)."""
    return LIGHT_ERROR * irradiance.mean() / irradiance.mean(1).clamp(min=1e-6)


def well_lit(parts: list[Pairs], irradiance: Tensor) -> list[Pairs]:
    """Pairs, a list a sun, shaded end first, weighted by how well its irradiance is known.

    In the gap below an object a mesh that is a trifle off changes the light (U, 3) by half.
    """
    doubt = irradiance_doubt(irradiance)
    doubt = doubt / STEP_WIDTH
    return [part.weighted(1 / (1 + doubt[part.first] ** 2)) for part in parts]


def of_one_material(parts: list[Pairs], log_albedo: Tensor, clipped: Tensor) -> Pairs:
    """Pairs of all suns, weighted by how alike they are but for the step that all share.

    Of pairs a sun, the end out of its light first, log albedo (U, 3), and clipped channels (U, 3).
    """
    weighted = []
    for part in parts:
        step = part.of(part.unclipped(clipped)).common_step(log_albedo)
        alike = part.likeness(log_albedo, ALIKE_HUE, ALIKE_BRIGHTNESS, step)
        weighted.append(part.weighted(alike))
    return Pairs.joined(weighted)


Floats = NDArray[np.float32]

# lobe in which a sun's visibility must be whole or nil for a point to be certain of it: 250 are 5
# degrees across, about what a mesh error of one grid cell does to a shadow
EDGE_SHARPNESS = 250.0
# share of that lobe that may be missing, or seen, of what counts as whole or nil
_EDGE_SHARE = 0.03
# cosine to a sun, of either sign, below which an error of the normals gives or takes that sun: 12
# degrees; normals are 7 to 10 off on average
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
        cosine = scene.facing((surfels.position[rows], normal), axes)
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
