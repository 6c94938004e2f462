# SPDX-License-Identifier: Apache-2.0
"""The held-out test by which anything enters the model beside diffuse material in plain light.

Views, or each view's part in its own prediction, are held out. A candidate enters if it predicts
them better than the plainer model by as many standard errors as its step asks for. Errors are
squared differences of display codes, compared in pairs and averaged over views or whatever errs
together.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.floating[Any]]
Table = tuple[Floats, Floats]  # of every block: sum of the weighted values, and sum of the weights

# of a block. Samples in one share their materials and the errors of the mesh (unit frame)
_SIDE = 0.2


def block_numbers(position: NDArray[np.float32]) -> NDArray[np.int64]:
    """Block number of points (N, 3) in the unit frame, from 0 without gaps.

    Neighbours share materials and errors of the mesh, so they are no independent draws; blocks
    nearly are.
    """
    cell = np.floor(position / _SIDE).astype(np.int64)
    return np.unique(cell, axis=0, return_inverse=True)[1].reshape(-1)


def table_of(blocks: NDArray[np.int64], value: Floats, weight: Floats) -> Table:
    """The sums of each block of values (N,) and their weights."""
    total, mass = (np.bincount(blocks, each).astype(float) for each in (value * weight, weight))
    return total, mass


def mean_of(table: Table) -> float:
    """Weighted mean over all blocks."""
    total, mass = table
    return float(total.sum() / max(mass.sum(), 1e-9))


def mean_error(table: Table) -> float:
    """Standard error of the mean over all blocks (ratio estimate); infinite below two of them."""
    total, mass = table
    count = int((mass > 0).sum())
    if count < 2:
        return float("inf")
    apart = (total - mean_of(table) * mass)[mass > 0] / mass.sum()
    return float(np.sqrt(count / (count - 1) * (apart**2).sum()))


def difference_error(table: Table, other: Table) -> float:
    """Standard error of the difference of two means over blocks (ratio estimate)."""
    size = max(len(table[0]), len(other[0]))
    padded = [np.pad(column, (0, size - len(column))) for column in (*table, *other)]
    mine, my_mass, its, its_mass = padded
    difference = mine / max(my_mass.sum(), 1e-9) - its / max(its_mass.sum(), 1e-9)
    count = int((my_mass > 0).sum())
    if count < 2:
        return float("inf")
    used = difference[my_mass > 0]
    return float(np.sqrt(count * used.var(ddof=1)))


Rows = NDArray[np.int64]

EVERY = 5  # one view in so many takes no part in a fit


@dataclass(frozen=True, slots=True, kw_only=True)
class HeldOutTest:
    """By how much a candidate predicts held-out photographs better."""

    plain: float  # root mean square error of the plainer model, display codes
    rich: float  # the same of the candidate
    gain: float  # difference of the mean squared errors, of codes in 0..1
    error: float  # its standard error

    @property
    def is_passed(self) -> bool:
        """Whether the candidate leads by more than one standard error."""
        return self.leads_by(1.0)

    def leads_by(self, least: float) -> bool:
        """Whether the candidate leads by more than so many standard errors, 0 or not."""
        return self.gain > least * self.error

    def words(self, least: float) -> str:
        """For the report, where more than so many standard errors are asked for."""
        times = self.gain / self.error if np.isfinite(self.error) and self.error > 0 else 0.0
        return (
            f"photographs that had no part in the fit are predicted with an error of "
            f"{self.rich:.2f} codes instead of {self.plain:.2f}, {times:+.1f} standard errors; "
            f"more than {least:g} are asked for"
        )

    @classmethod
    def of(cls, plain: Floats, rich: Floats, groupings: tuple[Rows, ...]) -> HeldOutTest:
        """By squared display errors (M,), 0..1, of both models at the same observations.

        `groupings` are numbers (M,) of what errs together, such as views and blocks.
        """
        ones = np.ones(len(plain))
        error, means = float("inf"), (0.0, 0.0)
        if len(plain):
            pairs = [(table_of(g, plain, ones), table_of(g, rich, ones)) for g in groupings]
            error = max(difference_error(*pair) for pair in pairs)
            means = mean_of(pairs[0][0]), mean_of(pairs[0][1])
        roots = [255 * float(np.sqrt(mean)) for mean in means]
        return cls(plain=roots[0], rich=roots[1], gain=means[0] - means[1], error=error)


def fitted_views(count: int) -> NDArray[np.bool_]:
    """Which of the views (count,) are fitted to; the held-out ones lie between them."""
    return np.arange(count) % EVERY != EVERY // 2
