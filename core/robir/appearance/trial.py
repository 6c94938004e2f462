# SPDX-License-Identifier: Apache-2.0
"""Materials of samples tried on photographs that had no part in their fit.

Every material predicts the kept views as it would be rendered: paint with the diffuse light that
the fitted views show of each sample under its specular layer, metal with the one base colour of its
part. Which of two is the better is told by `proof`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from robir.appearance.blocks import block_numbers
from robir.appearance.problem import Problem
from robir.appearance.proof import Proof, fitted_views
from robir.appearance.reflections import Reflections, ViewRays, reflected_share
from robir.appearance.seen import Seen, dense, in_views
from robir.appearance.statistics import display_mean

Floats = NDArray[np.float32]
Reals = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class Trial:
    """Some samples in the fitted views and in the kept ones.

    Attributes:
        problem: Scene under a tone curve.
        reflections: What the U samples reflect.
        fitted: Rays, what they show and which views show the samples, of the fitted views.
        kept: The same of the others.
        block: (U,) block of the surface that each sample lies in.
    """

    problem: Problem
    reflections: Reflections
    fitted: tuple[ViewRays, Seen, Tensor]
    kept: tuple[ViewRays, Seen, Tensor]
    block: NDArray[np.int64]

    @classmethod
    def of(
        cls,
        problem: Problem,
        looked: tuple[Reflections, ViewRays, Seen, Tensor],
        rows: NDArray[np.int64],
    ) -> Trial:
        """From what `looked_at` gives of the samples `rows`."""
        reflections, rays, seen, valid = looked
        is_fitted = fitted_views(valid.shape[1])
        fitted, kept = (in_views(rays, seen, valid, views) for views in (is_fitted, ~is_fitted))
        return cls(
            problem=problem,
            reflections=reflections,
            fitted=fitted,
            kept=kept,
            block=block_numbers(problem.scene.transport.surfels.position[rows]),
        )

    def kept_of(self, chosen: NDArray[np.bool_]) -> Tensor:
        """Numbers of the kept rays that show one of the chosen samples (U,), also seen before."""
        known = chosen & (self.fitted[2].sum(1) > 0).numpy()
        return torch.from_numpy(np.flatnonzero(known[self.kept[0].sample]))

    def paint_errors(self, chosen: Tensor, level: Reals | None) -> Reals:
        """Squared errors (M,) of kept rays if their samples are paint.

        Args:
            chosen: Numbers (M,) of the kept rays.
            level: (U,) roughness of the specular layer, or None where there is none.
        """
        rays, seen = self.kept[0].of(chosen), self.kept[1].of(chosen)
        if level is None:
            return seen.squared(self._diffuse(np.unique(rays.sample), None)[rays.sample])
        errors = np.zeros(len(chosen))
        levels = level[rays.sample]
        for roughness in np.unique(levels):
            own = torch.from_numpy(np.flatnonzero(levels == roughness))
            part, shown = rays.of(own), seen.of(own)
            diffuse = self._diffuse(np.unique(part.sample), float(roughness))[part.sample]
            through = 1 - reflected_share(part, float(roughness))[:, None]
            specular = self.reflections.radiance(part, float(roughness))[:, 0]
            errors[own.numpy()] = shown.squared(through * diffuse + specular)
        return errors

    def metal_errors(self, chosen: Tensor, base: Floats, roughness: float) -> Reals:
        """Squared errors (M,) of kept rays as metal of one base colour (3,) and roughness."""
        rays, seen = self.kept[0].of(chosen), self.kept[1].of(chosen)
        white = self.reflections.radiance(rays, roughness)[:, 1]
        return seen.squared(white * torch.from_numpy(base))

    def proof(self, chosen: Tensor, plain: Reals, rich: Reals) -> Proof:
        """What kept rays say of two models by their errors (M,)."""
        rays = self.kept[0].of(chosen)
        return Proof.of(plain, rich, (rays.view, self.block[rays.sample]))

    def _diffuse(self, rows: NDArray[np.int64], roughness: float | None) -> Tensor:
        """Diffuse radiance (U, 3) by the fitted views, right of the samples `rows` alone."""
        rays, seen, valid = self.fitted
        own = torch.from_numpy(np.flatnonzero(np.isin(rays.sample, rows)))
        rays, below = rays.of(own), seen.linear[own]
        if roughness is not None:
            specular = self.reflections.radiance(rays, roughness)[:, 0]
            through = 1 - reflected_share(rays, roughness)[:, None]
            below = torch.maximum(below - specular, 0.02 * below) / through
        result = torch.zeros(len(valid), 3)
        table = dense(below, rays, (valid.shape[0], valid.shape[1]))[rows]
        result[rows] = display_mean(table, valid[rows].float(), self.problem.curve)
        return result
