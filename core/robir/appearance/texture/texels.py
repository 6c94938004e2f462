# SPDX-License-Identifier: Apache-2.0
"""Points of the texture atlas, what is known of them, and what arrives at them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from torch import Tensor

from robir.appearance.light.problem import SUN_RAY_PAIRS, Problem
from robir.appearance.light.solver import Light
from robir.appearance.material.specular import SpecularMaterial, specular_towards
from robir.appearance.texture.residual_shading import with_normals
from robir.workers import num_workers

Floats = NDArray[np.float32]

MIN_ALBEDO = 0.002  # least albedo of a texel
MAX_ALBEDO = 0.95  # largest
# how far apart two opposite normals count in searches for neighbours, half of it, unit frame
NORMAL_SCALE = 0.15
# of a sample from a texel, spacings of the samples; adds to the distance whose inverse square says
# what the sample counts
_LEAST_DISTANCE = 0.2


@dataclass(frozen=True, slots=True, kw_only=True)
class Texels:
    """Surface points of the texture atlas."""

    position: Floats  # (N, 3) unit frame
    normal: Floats  # (N, 3) unit


@dataclass(frozen=True, slots=True, kw_only=True)
class TexelAlbedo:
    """Albedo of the texels with how well it is known."""

    albedo: Floats  # (N, 3) float32, linear Rec.709
    coverage: NDArray[np.int64]  # (N,) int, views that show the texel
    read: Floats  # (N, 3) float32, albedo before smoothing
    uncertainty: Floats  # (N,) float32, one standard error of log albedo, see `standard_error`
    roughness: Floats  # (N,) float32
    metallic: Floats  # (N,) float32, 0 or 1
    # (N, 3) float32, what arrives; None at texels finer than those that were solved
    irradiance: Floats | None = None


class Blend:
    """Values of surface samples at texels, from those alike in orientation; `nearest` (N,) one."""

    def __init__(self, problem: Problem, texels: Texels) -> None:
        """Find the nearest samples of every texel, once."""
        surfels = problem.scene.transport.surfels
        seen = np.flatnonzero(problem.radiance.seen.numpy())
        points = with_normals(surfels.position, surfels.normal, NORMAL_SCALE)[seen]
        query = with_normals(texels.position, texels.normal, NORMAL_SCALE)
        distance, index = cKDTree(points).query(query, k=4, eps=0.1, workers=num_workers())
        weight = 1 / (distance + _LEAST_DISTANCE * surfels.spacing) ** 2
        self._index = seen[index]
        self.nearest = self._index[:, 0]
        self._weight = (weight / weight.sum(1, keepdims=True)).astype(np.float32)

    def __call__(self, values: Tensor) -> Floats:
        """Values (S, C) of all samples at the texels, (N, C)."""
        return np.einsum("nk,nkc->nc", self._weight, values.numpy()[self._index])


def sun_transfer(
    problem: Problem, light: Light, texels: Texels, sharpness: Floats, samples: int
) -> Floats:
    """Visibility times cosine of every sharp lobe at every texel, (N, J)."""
    points = (texels.position, texels.normal)
    return problem.scene.sharp_transfer_at(points, light.axes, sharpness, samples)


def radiance_towards(
    solved: tuple[Problem, Light, SpecularMaterial],
    points: Texels,
    rays: tuple[NDArray[np.int64] | slice, Floats],
    material: tuple[Floats, Floats],
) -> tuple[Floats, Floats]:
    """Radiance (M, 3), linear Rec.709, that points send towards cameras, and of the matt texture.

    What arrives at a point is found once, however many cameras see it. `rays` are the point of each
    of M rays, and its direction (M, 3) unit, towards the camera; `material` is albedo (M, 3) and
    metal (M, 1) of each.
    """
    (problem, light, specular), (point, towards), (albedo, metallic) = solved, rays, material
    blend = Blend(problem, points)
    soft = blend(problem.scene.soft @ light.amplitudes.soft + problem.indirect)
    samples = 2 * SUN_RAY_PAIRS
    sun = sun_transfer(problem, light, points, light.sharpness, samples)
    irradiance = (soft + sun @ light.amplitudes.sharp.numpy())[point]
    dielectric, metal, through = specular_towards(
        problem, light, specular, blend.nearest[point], towards
    )
    matt = albedo * irradiance / np.pi
    return (1 - metallic) * (through * matt + dielectric) + metallic * albedo * metal, matt
