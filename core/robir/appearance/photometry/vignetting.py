# SPDX-License-Identifier: Apache-2.0
"""A lens that darkens the corners of all photographs alike.

With s the square of the distance from the middle, 1 in the corners, a point p in view v shows

    log linear(p, v) = point(p) + gain(v) - k s(p, v) + highlight or error,

solved by robust least squares together with the gains. It is the law cos^4 to first order in s.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from robir.appearance.photometry.robust import Weighing, solve_views

Array = NDArray[np.float64]
Codes = NDArray[np.uint8]

_PRIOR = 1.0  # standard deviation of the falloff's strength before anything is seen (log radiance)


@dataclass(frozen=True, slots=True)
class Falloff:
    """How much darker than in its middle a photograph is."""

    strength: float = 0.0  # natural logarithm of the middle's radiance over the corners'

    @property
    def corner_stops(self) -> float:
        """Stops (log2) by which the corners are darker."""
        return self.strength / float(np.log(2))

    def log(self, off_axis: Codes) -> Array:
        """Log radiance against the middle, of codes as in `Observations.off_axis`."""
        return -self.strength * (off_axis / 255.0)

    def factor(self, off_axis: Codes) -> Tensor:
        """Factors (..., 1) float32 on linear radiance, of codes (...)."""
        return torch.from_numpy(np.exp(self.log(off_axis)).astype(np.float32))[..., None]


NO_FALLOFF = Falloff()  # corners as bright as the middle


def solve_falloff(log: Array, normals: NDArray[np.float32], off_axis: Codes) -> Falloff:
    """Falloff of all views; arguments as for `solve_gains`, and `Observations.off_axis` (P, V)."""
    known = np.isfinite(log[..., 0])
    values = np.nan_to_num(log).mean(2)
    square = off_axis / 255.0
    weighing = Weighing(known, normals)
    strength, gains = 0.0, np.zeros(log.shape[1])
    for _ in weighing.rounds():
        strength, gains, points = _least_squares(values, square, weighing, _PRIOR)
        weighing.renew(np.abs(values + strength * square - gains - points[:, None]))
    return Falloff(strength)


def _least_squares(
    values: Array, square: Array, weighing: Weighing, prior: float
) -> tuple[float, Array, Array]:
    """Strength, gains (V,) and points (P,) whose sums are nearest to the values (P, V)."""
    weight = weighing.weight
    mass = weight.sum(1)
    share = weight / mass[:, None]
    columns = np.stack([-square, values], axis=2)
    columns -= np.einsum("pv,pvk->pk", share, columns)[:, None]
    right = np.einsum("pv,pvk->vk", weight, columns)
    system = np.diag(weight.sum(0)) - weight.T @ share
    through = solve_views(system, right, weighing.prior())
    moments = np.einsum("pvk,pv,pvl->kl", columns, weight, columns) - right.T @ through
    ridge = weight[weighing.known].mean() * (weighing.noise / prior) ** 2
    strength = float(moments[0, 1] / (moments[0, 0] + ridge))
    gains = through[:, 1] - strength * through[:, 0]
    points = (share * (values + strength * square - gains)).sum(1)
    return strength, gains, points
