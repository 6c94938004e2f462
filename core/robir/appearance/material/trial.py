# SPDX-License-Identifier: Apache-2.0
"""Materials of samples tried on held-out photographs.

Metal is predicted with the one base colour of its part, a dielectric with the diffuse light under
its specular layer. That is each sample's own, so views are parted in folds, and each fold is
predicted by the rest.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from robir.appearance.held_out_test import EVERY, HeldOutTest
from robir.appearance.light.problem import Problem
from robir.appearance.light.solver import Light
from robir.appearance.material.observed import LEAST_DIFFUSE, ObservedRays, looked_at
from robir.appearance.material.reflections import Reflections, ViewRays, reflected_share

Reals = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class MaterialTrial:
    """Some samples in all views."""

    reflections: Reflections  # what the U samples reflect
    rays: ViewRays  # their observations
    seen: ObservedRays  # what these show

    @classmethod
    def of(cls, problem: Problem, light: Light, rows: NDArray[np.int64]) -> MaterialTrial:
        """Samples (U,) of a scene under a light."""
        reflections, rays, seen, _ = looked_at(problem, light, rows)
        return cls(reflections=reflections, rays=rays, seen=seen)

    def rays_of(self, chosen: NDArray[np.bool_]) -> Tensor:
        """Numbers of the rays of chosen samples (U,) that views of another fold show as well."""
        fold = self.rays.view % EVERY
        count = np.zeros((len(chosen), EVERY))
        np.add.at(count, (self.rays.sample, fold), 1)
        elsewhere = count.sum(1)[self.rays.sample] > count[self.rays.sample, fold]
        return torch.from_numpy(np.flatnonzero(chosen[self.rays.sample] & elsewhere))

    def dielectric_errors(self, chosen: Tensor, level: Reals | None) -> Reals:
        """Squared errors (M,) of rays if their samples are dielectric.

        `level` (U,) is the roughness of the specular layer, or None where there is none.
        """
        rays, seen = self.rays.of(chosen), self.seen.of(chosen)
        specular, through = torch.zeros(len(chosen), 3), torch.ones(len(chosen), 1)
        levels = np.zeros(0) if level is None else level[rays.sample]
        for roughness in np.unique(levels):
            own = torch.from_numpy(np.flatnonzero(levels == roughness))
            part = rays.of(own)
            specular[own] = self.reflections.radiance(part, float(roughness))[:, 0]
            through[own] = 1 - reflected_share(part, float(roughness))[:, None]
        below = predicted_below(seen, rays, specular, through)
        return seen.squared(below + specular)

    def metal_errors(self, chosen: Tensor, roughness: float) -> Reals:
        """Squared errors (M,) of rays as metal of one roughness, with the base colour it reads.

        No prior of metals holds that colour, as the light's level is not known well.
        """
        if not len(chosen):
            return np.zeros(0)
        seen = self.seen.of(chosen)
        white = self.reflections.radiance(self.rays.of(chosen), roughness)[:, 1].clamp(min=1e-5)
        return seen.squared(white * (seen.linear / white).median(0).values)

    def compare(self, chosen: Tensor, plain: Reals, rich: Reals) -> HeldOutTest:
        """What rays say of two models by their errors (M,)."""
        return HeldOutTest.of(plain, rich, (self.rays.view[chosen.numpy()],))


def predicted_below(
    seen: ObservedRays, rays: ViewRays, specular: Tensor, through: Tensor
) -> Tensor:
    """Diffuse radiance (M, 3) that leaves rays' samples, as other folds of the views have it.

    Of what is reflected (M, 3), and the share (M, 1) of diffuse light that is let through.
    """
    least = LEAST_DIFFUSE * seen.linear
    below = torch.maximum(seen.linear - specular, least) / through
    shown = seen.curve.display_from_linear(below).float()
    others = _by_other_folds(shown, rays, EVERY).clamp(0, 1)
    return through * seen.curve.linear_from_display(others).float()


def _by_other_folds(shown: Tensor, rays: ViewRays, every: int) -> Tensor:
    """Mean (M, 3) over the rays of the same sample in all other folds than each one's own."""
    sample = torch.from_numpy(rays.sample)
    number = sample * every + torch.from_numpy(rays.view % every)
    size = int(sample.max()) + 1 if len(sample) else 0
    values = torch.cat([shown, torch.ones(len(shown), 1)], 1)
    whole = torch.zeros(size, 4).index_add_(0, sample, values)
    own = torch.zeros(size * every, 4).index_add_(0, number, values)
    rest = whole[sample] - own[number]
    return rest[:, :3] / rest[:, 3:].clamp(min=1)
