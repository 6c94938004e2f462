# SPDX-License-Identifier: Apache-2.0
"""How much brighter each photograph is than the others, and whether that is its exposure.

An exposure changes all points alike, a highlight depends on where they face. So gains from points
of some orientations must let photographs predict points of the others.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import torch
from numpy.typing import NDArray

from robir.maths.tone import curve_from_name

Array = NDArray[np.float64]

_PRIOR_STOPS = 0.5  # standard deviation of gains before anything is seen (stops)
_NORMAL_SHARPNESS = 10.0  # of the lobe within which normals share one vote: 10 are about 25 degrees
# deviation between views of which a photograph's noise alone is capable (log radiance)
_NOISE = 0.02
# deviation from which an observation counts little (Geman-McClure), at first (log radiance)
FIRST_WIDTH = 0.4
LAST_WIDTH = 0.05  # the same in the end (log radiance)
NARROWING = 0.7  # by what that shrinks from round to round
_NUM_ROUNDS = 20  # solves, weights renewed after each


class Weighing:
    """Weights (P, V) that are renewed from round to round, 0 where a view does not show a point.

    Highlights change all points of a plane like a gain, but each orientation by another amount:
    every orientation has one vote, in which its dull points count more. `noise` is the typical
    deviation of what counts, log radiance.
    """

    def __init__(self, known: NDArray[np.bool_], normals: NDArray[np.float32]) -> None:
        self.known = known
        self.noise = FIRST_WIDTH
        self.weight = known.astype(np.float64)
        self._alike = np.exp(_NORMAL_SHARPNESS * (normals @ normals.T - 1))
        self._dull, self._trust = np.ones(len(known)), known.astype(np.float64)
        self._width = FIRST_WIDTH

    def rounds(self) -> Iterator[int]:
        """Rounds; in each, solve with `weight` and hand what is left to `renew`."""
        for step in range(_NUM_ROUNDS):
            self.weight = self._trust * (self._dull / (self._alike @ self._dull))[:, None]
            self._width = max(LAST_WIDTH, FIRST_WIDTH * NARROWING**step)
            yield step

    def prior(self) -> float:
        """Weight with which every gain is drawn to 0."""
        deviation = _PRIOR_STOPS * np.log(2)
        return self.weight[self.known].mean() * (self.noise / deviation) ** 2

    def renew(self, apart: Array) -> None:
        """Take what is left, (P, V) absolute deviations, into account."""
        self._trust = self.known / (1 + (apart / self._width) ** 2) ** 2
        apart[~self.known] = np.nan
        self._dull = 1 / (np.nanmedian(apart, axis=1) ** 2 + _NOISE**2)
        self.noise = 1.48 * float(np.nanmedian(apart))


def solve_views(system: Array, right: Array, prior: float) -> Array:
    """Unknowns (V, K), mean 0, of views that differences between views determine.

    Rows of the normal equations (V, V) and columns of `right` sum to 0. What is common to all views
    is pinned to 0, as the prior vanishes where photographs agree to the last bit.
    """
    pin = np.trace(system) / len(system) ** 2
    return np.linalg.solve(system + prior * np.eye(len(system)) + pin, right)


_LEAST_ERRORS = 2.0  # standard errors from which what two halves of the points tell is no chance

Floats = NDArray[np.float32]

# cells per unit of a normal's components, points of one erring together: some forty degrees
_ORIENTATION_CELLS = 1.5
LEAST_POINTS = 50  # points in all from which photographs can be compared


def solve_gains(log: Array, normals: Floats) -> Array:
    """Log gains (V, 3), of mean 0, by log radiance (P, V, 3), NaN where a point is not shown.

    Every point is shown by some view; normals (P, 3) are unit.
    """
    known = np.isfinite(log[..., 0])
    values = np.nan_to_num(log)
    weighing = Weighing(known, normals)
    gains = np.zeros(log.shape[1:])
    for _ in weighing.rounds():
        gains, points = _least_squares(values, weighing.weight, weighing.prior())
        weighing.renew(np.abs(values - gains - points[:, None]).mean(2))
    return gains


def _least_squares(values: Array, weight: Array, prior: float) -> tuple[Array, Array]:
    """Gains (V, 3) and points (P, 3) whose sums are nearest to the values, points eliminated."""
    mass = weight.sum(1)
    mean = np.einsum("pv,pvc->pc", weight, values) / mass[:, None]
    right = np.einsum("pv,pvc->vc", weight, values - mean[:, None])
    system = np.diag(weight.sum(0)) - weight.T @ (weight / mass[:, None])
    gains = solve_views(system, right, prior)
    return gains, mean - weight @ gains / mass[:, None]


def real_share(log: Array, normals: Floats) -> float:
    """How much of the gains is exposure, 0..1; the rest is highlights and noise.

    Two halves of the points, by orientation, give gain + e each. The mean of their products
    estimates the variance of the gains, and over that of their mean it is what is left of them
    (James and Stein 1961). What may be chance counts as none, as do too few points. Of log radiance
    (P, V, 3) under a plain tone curve, without any falloff, NaN where a view does not show a point,
    and normals (P, 3).
    """
    orientation = orientations(normals)
    is_first = halves(orientation)[orientation]
    if min(is_first.sum(), (~is_first).sum()) < LEAST_POINTS:
        return 0.0
    first, second = (solve_gains(log[half], normals[half]) for half in (is_first, ~is_first))
    product, mean = (first * second).mean(), (((first + second) / 2) ** 2).mean()
    # channels of one photograph err together, so photographs are what is counted
    chance = np.sqrt((first**2).mean() * (second**2).mean() / len(first))
    return float(min(product / mean, 1.0)) if product > _LEAST_ERRORS * chance else 0.0


def orientations(normals: Floats) -> NDArray[np.int64]:
    """Numbers (P,) of orientations that err together, from 0 without gaps."""
    cells = np.rint(_ORIENTATION_CELLS * normals)
    return np.unique(cells, axis=0, return_inverse=True)[1].reshape(-1)


def halves(orientation: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Which orientations make up one half of the points, about: the largest first, by turns."""
    counts, lead = np.bincount(orientation), 0
    is_first = np.zeros(len(counts), bool)
    for number in np.argsort(-counts, kind="stable"):
        is_first[number] = lead <= 0
        lead += int(counts[number]) * (1 if lead <= 0 else -1)
    return is_first


def others_errors(log: Array, gains: Array) -> Array:
    """Squared display errors (P, V) of what each view shows, predicted by the others."""
    equalised = log - gains
    known = np.isfinite(equalised[..., :1])
    values = np.where(known, equalised, 0.0)
    others = (values.sum(1, keepdims=True) - values) / np.maximum(
        known.sum(1, keepdims=True) - 1, 1
    )
    curve = curve_from_name("standard")
    seen, predicted = (
        curve.display_from_linear(torch.from_numpy(np.exp(shown)))
        for shown in (np.where(known, log, 0.0), others + gains)
    )
    return ((seen - predicted) ** 2).mean(2).numpy()
