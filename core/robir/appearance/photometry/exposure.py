# SPDX-License-Identifier: Apache-2.0
"""Photographs of one capture that were not exposed, balanced or lit alike.

A surface point shows every camera about the same radiance, so of photographs of the same points

    log linear(p, v) = point(p) + gain(v) + highlight or error

is solved by robust least squares under every tone curve; own lights add slopes (`own_light`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from robir.appearance.photometry.gains import Weighing, solve_gains, solve_views
from robir.appearance.photometry.own_light import solve_slopes
from robir.maths.tone_curve import AbstractToneCurve
from robir.transport.observe import Observations

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
    """Falloff of all views; arguments as for `solve_gains`, and `Observations.off_axis` (P, V).

    With s the square of the distance from the middle, 1 in the corners, log linear(p, v) = point(p)
    + gain(v) - k s(p, v) + highlight or error: the law cos^4 to first order in s.
    """
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


Floats = NDArray[np.float32]

# cosine from which a view of a point counts: flatter ones show mostly specular reflection
LEAST_COSINE = 0.5
_DARKEST = 10  # code from which a curve's slope is worth something in all three channels (codes)
_BRIGHTEST = 250  # code up to which it is (codes)
LEAST_VIEWS = 4  # views of a point from which photographs can be compared


@dataclass(frozen=True, slots=True)
class Gains:
    """How much brighter than at the capture's common exposure each photograph is, and where."""

    # factors (3,) on linear radiance by the view's name, of geometric mean 1 in every channel;
    # empty where all photographs are alike
    by_view: Mapping[str, Array]
    falloff: Falloff = NO_FALLOFF  # of all photographs towards their corners
    # (3,) log radiance per unit of the normal, unit frame, by the view's name; empty where all
    # photographs are in one light
    slopes: Mapping[str, Array] = field(default_factory=dict)

    def at(
        self,
        views: Sequence[str],
        off_axis: NDArray[np.uint8],
        normals: Floats,
        view: Tensor | None = None,
    ) -> Tensor:
        """Factors (..., 3) float32 on what V views show, 1 where nothing is known.

        Of `Observations.off_axis` (...) and normals (..., 3), unit frame; `view` (...) is which
        view shows it, None where the last of these axes is that of all.
        """
        factors = _rows(self.by_view, np.ones(3), views)
        if view is not None:
            factors = factors[view]
        if self.slopes:
            slopes = _rows(self.slopes, np.zeros(3), views)
            turned = torch.from_numpy(normals) * (slopes if view is None else slopes[view])
            factors = factors * turned.sum(-1, keepdim=True).exp()
        return factors * self.falloff.factor(off_axis) if self.falloff.strength else factors

    def plain(self) -> dict[str, Any]:
        """As plain values: "steps" (log2) per channel by view, "corner_steps", "slope_steps"."""
        return {
            "steps": {name: np.log2(gain).tolist() for name, gain in self.by_view.items()},
            "corner_steps": self.falloff.corner_stops,
            "slope_steps": {name: (s / np.log(2)).tolist() for name, s in self.slopes.items()},
        }

    def undone(self, linear: Tensor, observations: Observations, normals: Floats) -> Tensor:
        """Radiance (N, V, 3) at the common exposure, in the common light; itself if all are alike.

        What is clipped is at least as bright as the brightest that the point shows unclipped.
        """
        if not self.by_view and not self.falloff.strength:
            return linear
        equalised = linear / self.at(observations.views, observations.off_axis, normals[:, None])
        clipped = torch.from_numpy(observations.clipped)
        hidden = clipped | torch.from_numpy(observations.weight <= 0)[..., None]
        brightest = equalised.masked_fill(hidden, 0.0).amax(1, keepdim=True)
        return torch.where(clipped, torch.maximum(equalised, brightest), equalised)


@dataclass(frozen=True, slots=True, kw_only=True)
class ExposureModel:
    """How photographs were exposed, to be solved under any tone curve."""

    observations: Observations  # a few surface points in all views, the held-out ones included
    normals: Floats  # (N, 3) of the points
    gain_share: float  # how much of the gains between photographs is exposure, 0..1
    has_falloff: bool  # whether they are darker towards their corners
    has_own_lights: bool = False  # whether each is in a light of its own

    def gains(self, curve: AbstractToneCurve) -> Gains:
        """Gains of all views, and their falloff, under a tone curve."""
        log, kept = comparable(self.observations, curve)
        normals, off_axis = self.normals[kept], self.observations.off_axis[kept]
        falloff = NO_FALLOFF
        if self.has_falloff:
            falloff = solve_falloff(log, normals, off_axis)
            log = log - falloff.log(off_axis)[..., None]
        if not self.gain_share:
            return Gains({}, falloff)
        names, slopes = self.observations.views, {}
        if self.has_own_lights:
            rows = solve_slopes(log, normals)
            slopes = dict(zip(names, rows, strict=True))
            log = log - (normals @ rows.T)[..., None]
        rows = self.gain_share * solve_gains(log, normals)
        by_view = {name: np.exp(row) for name, row in zip(names, rows, strict=True)}
        return Gains(by_view, falloff, slopes)


def _rows(by_view: Mapping[str, Array], plain: Array, views: Sequence[str]) -> Tensor:
    return torch.from_numpy(np.array([by_view.get(view, plain) for view in views], np.float32))


def comparable(
    observations: Observations, curve: AbstractToneCurve
) -> tuple[Array, NDArray[np.bool_]]:
    """Log radiance (P, V, 3) of the points that enough views show well, and which (N,) these are.

    NaN where a view does not show a point well.
    """
    log = log_radiance(observations, curve)
    kept = np.isfinite(log[..., 0]).sum(1) >= LEAST_VIEWS
    return log[kept], kept


def log_radiance(observations: Observations, curve: AbstractToneCurve) -> Array:
    """Log radiance (N, V, 3) under a tone curve, NaN where a view does not show a point well."""
    log = np.log(decoded(observations, curve).numpy().astype(np.float64).clip(1e-4))
    display = observations.display
    poor = (observations.weight < LEAST_COSINE)[..., None] | observations.clipped
    poor = poor | (display < _DARKEST) | (display > _BRIGHTEST)
    log[poor.any(2)] = np.nan
    return log


def decoded(observations: Observations, curve: AbstractToneCurve) -> Tensor:
    """Radiance (N, V, 3) float32, linear Rec.709, as it was exposed.

    Anything where a view does not show a point.
    """
    seen = torch.from_numpy(observations.weight > 0)
    return curve.linear_from_codes(torch.from_numpy(observations.display), seen)
