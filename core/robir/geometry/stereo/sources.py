# SPDX-License-Identifier: Apache-2.0
"""Which photographs a photograph is compared with."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

NARROW, WIDE = 1 / 3, 5 / 6
"""Spread of angles below and above the wanted one that will do, as a share of it."""

APART = 0.5
"""Angle between two sources at which they count as two, as a share of the wanted one."""

LEAST_SCORE = 0.02
"""Sources that fit less are left out."""


def angles_between(positions: NDArray[np.float64]) -> NDArray[np.float64]:
    """Angles (V, V), degrees, between camera centres (V, 3) as seen from the origin."""
    towards = positions / np.linalg.norm(positions, axis=1, keepdims=True)
    return np.degrees(np.arccos(np.clip(towards @ towards.T, -1.0, 1.0)))


def choose_sources(
    positions: NDArray[np.float64], count: int, wanted: float
) -> list[NDArray[np.int64]]:
    """For each photograph, others at a good angle from it that lie on different sides of it.

    Args:
        positions: (V, 3) camera centres, unit frame.
        count: Most sources of a photograph.
        wanted: Best angle at the object, degrees.

    Returns:
        Indices, at most `count` for each photograph, the best first.
    """
    angle = angles_between(positions)
    spread = np.where(angle < wanted, NARROW, WIDE) * wanted
    fits = np.exp(-(((angle - wanted) / spread) ** 2))
    np.fill_diagonal(fits, 0.0)
    chosen = []
    for own in fits:
        score, picked = own.copy(), []
        while len(picked) < count and score.max() > LEAST_SCORE:
            best = int(score.argmax())
            picked.append(best)
            score *= 1.0 - np.exp(-((angle[best] / (APART * wanted)) ** 2))
        chosen.append(np.array(picked, np.int64))
    return chosen
