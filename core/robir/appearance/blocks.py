# SPDX-License-Identifier: Apache-2.0
"""Means over samples or pairs, with standard errors over blocks of the surface.

Neighbours share materials and errors of the mesh, so they are no independent draws; blocks nearly
are.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.floating[Any]]
Table = tuple[Floats, Floats]  # of every block: sum of the weighted values, and sum of the weights

# of a block. Samples in one share their materials and the errors of the mesh (unit frame)
_SIDE = 0.2


def block_numbers(position: NDArray[np.float32]) -> NDArray[np.int64]:
    """Block number of points (N, 3) in the unit frame, from 0 without gaps."""
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
