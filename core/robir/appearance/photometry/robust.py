# SPDX-License-Identifier: Apache-2.0
"""How much each observation counts where photographs of the same points are compared."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from robir.appearance.photometry.config import RobustConfig

Array = NDArray[np.float64]


class Weighing:
    """Weights that are renewed from round to round.

    A plane's sheen changes a whole photograph of it as a gain would, but each orientation by
    another amount: every orientation has one vote, in which its dull points count more than its
    glossy ones.

    Attributes:
        known: (P, V) bool, where a view shows a point.
        weight: (P, V), 0 where it does not.
        noise: Typical deviation of what counts, log radiance.
    """

    def __init__(
        self, known: NDArray[np.bool_], normals: NDArray[np.float32], config: RobustConfig
    ) -> None:
        self.known = known
        self.noise = config.first_width
        self._config = config
        self.weight = known.astype(np.float64)
        self._alike = np.exp(config.normal_sharpness * (normals @ normals.T - 1))
        self._dull, self._trust = np.ones(len(known)), known.astype(np.float64)
        self._width = config.first_width

    def rounds(self) -> Iterator[int]:
        """Rounds; in each, solve with `weight` and hand what is left to `renew`."""
        config = self._config
        for step in range(config.num_rounds):
            self.weight = self._trust * (self._dull / (self._alike @ self._dull))[:, None]
            self._width = max(config.last_width, config.first_width * config.narrowing**step)
            yield step

    def prior(self) -> float:
        """Weight with which every gain is drawn to 0."""
        deviation = self._config.prior_steps * np.log(2)
        return self.weight[self.known].mean() * (self.noise / deviation) ** 2

    def renew(self, apart: Array) -> None:
        """Take what is left, (P, V) absolute deviations, into account."""
        self._trust = self.known / (1 + (apart / self._width) ** 2) ** 2
        apart[~self.known] = np.nan
        self._dull = 1 / (np.nanmedian(apart, axis=1) ** 2 + self._config.noise**2)
        self.noise = 1.48 * float(np.nanmedian(apart))


def solve_views(system: Array, right: Array, prior: float) -> Array:
    """Unknowns of views that differences between views determine.

    What is common to all views is free but for the prior, and that vanishes where photographs agree
    to the last bit: it is pinned to 0 besides, which changes nothing else.

    Args:
        system: (V, V) normal equations, whose rows sum to 0.
        right: (V, K), whose columns sum to 0.
        prior: Weight with which every unknown is drawn to 0.

    Returns:
        (V, K), mean 0.
    """
    pin = np.trace(system) / len(system) ** 2
    return np.linalg.solve(system + prior * np.eye(len(system)) + pin, right)
