# SPDX-License-Identifier: Apache-2.0
"""What the photographs show along rays from the samples, to be compared with predictions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from robir.appearance.light.problem import Problem
from robir.appearance.light.solver import Light
from robir.appearance.material.reflections import Reflections, ViewRays, view_rays
from robir.appearance.photometry.statistics import darker_view_weights
from robir.maths.tone_curve import AbstractToneCurve

# display error, 0..1, beyond which the mesh is wrong, whatever the material, and more says no more
_MOST_ERROR = 0.15
LEAST_DIFFUSE = 0.02  # least share of an observation's radiance that is no reflection


@dataclass(frozen=True, slots=True)
class ObservedRays:
    """What the photographs show along some rays."""

    curve: AbstractToneCurve  # tone curve
    linear: Tensor  # (M, 3) radiance
    display: Tensor  # (M, 3) display codes, 0..1
    clipped: Tensor  # (M, 3) whether the true value is at least `linear`
    gain: Tensor  # (M, 1) exposure of the photograph there

    def of(self, chosen: Tensor) -> ObservedRays:
        """Some of the rays."""
        parts = (part[chosen] for part in (self.linear, self.display, self.clipped, self.gain))
        return ObservedRays(self.curve, *parts)

    def excess(self, prediction: Tensor) -> Tensor:
        """Display codes (M, 3), 0..1, beyond those of a predicted radiance (M, 3)."""
        return self.display - self.curve.display_from_linear(self.gain * prediction)

    def error(self, prediction: Tensor) -> Tensor:
        """Display error (M,) of a predicted radiance (M, 3)."""
        return self.counted(self.excess(prediction), prediction)

    def squared(self, prediction: Tensor) -> NDArray[np.float64]:
        """Squared display error (M,) of a predicted radiance (M, 3), for proofs."""
        off = self.excess(prediction).masked_fill(self.clipped & (prediction > self.linear), 0)
        return (off**2).mean(1).clamp(max=_MOST_ERROR**2).double().numpy()

    def counted(self, excess: Tensor, prediction: Tensor) -> Tensor:
        """The same where the excess (M, 3) is known."""
        shown = excess.abs().masked_fill(self.clipped & (prediction > self.linear), 0)
        return shown.clamp(max=_MOST_ERROR).mean(1)


def seen_along(problem: Problem, rays: ViewRays, rows: NDArray[np.int64]) -> ObservedRays:
    """What the photographs show of some samples."""
    transport = problem.scene.transport
    observations, normals = transport.observations, transport.surfels.normal[rows]
    sample, view = torch.from_numpy(rays.sample), torch.from_numpy(rays.view)
    off_axis = observations.off_axis[rows][rays.sample, rays.view]
    return ObservedRays(
        curve=problem.curve,
        linear=problem.linear[rows][sample, view],
        display=torch.from_numpy(observations.display[rows].astype(np.float32) / 255)[sample, view],
        clipped=torch.from_numpy(observations.clipped[rows])[sample, view],
        gain=problem.gains.at(observations.views, off_axis, normals[rays.sample], view),
    )


def looked_at(
    problem: Problem, light: Light, rows: NDArray[np.int64]
) -> tuple[Reflections, ViewRays, ObservedRays, Tensor]:
    """What samples (U,) reflect, their rays, what these show, and which views show them (U, V)."""
    transport = problem.scene.transport
    observations, directions = transport.observations, transport.visibility.directions
    rays = view_rays(transport.surfels, observations, rows, directions)
    valid = torch.from_numpy(observations.weight[rows] > 0)
    reflections = Reflections(problem, light, rows)
    return reflections, rays, seen_along(problem, rays, rows), valid


def dense(values: Tensor, rays: ViewRays, shape: tuple[int, int]) -> Tensor:
    """Scatter a flat list (M, C) into (U, V, C), zero where there is no observation."""
    table = torch.zeros(*shape, values.shape[1])
    table[rays.sample, rays.view] = values
    return table


def diffuse_below(
    seen: ObservedRays, specular: Tensor, through: Tensor, seen_by: tuple[ViewRays, Tensor]
) -> Tensor:
    """Diffuse radiance (M, 3) that leaves samples under their specular layer, alike in all views.

    Of what is reflected (M, 3), the share (M, 1) let through, the rays, and (U, V) which views
    show.
    """
    rays, valid = seen_by
    least = LEAST_DIFFUSE * seen.linear
    diffuse = torch.maximum(seen.linear - specular, least) / through
    return low_mean(diffuse, rays, valid)[rays.sample] * through


def low_mean(linear: Tensor, rays: ViewRays, valid: Tensor) -> Tensor:
    """Mean (U, 3) over each sample's darker views of a flat list (M, 3)."""
    table = dense(linear, rays, (valid.shape[0], valid.shape[1]))
    return (table * darker_view_weights(table, valid)[..., None]).sum(1)
