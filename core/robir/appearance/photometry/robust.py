# SPDX-License-Identifier: Apache-2.0
"""How much each observation counts where photographs of the same points are compared."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

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
