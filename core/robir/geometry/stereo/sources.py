# SPDX-License-Identifier: Apache-2.0
"""Which photographs a photograph is compared with."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

_NARROW = 1 / 3  # spread of angles below the wanted one that will do, as a share of it
_WIDE = 5 / 6  # the same above it
_APART = 0.5  # angle between two sources at which they count as two, as a share of the wanted one
_LEAST_SCORE = 0.02  # sources that fit less are left out
_SOURCES = 4  # photographs that each is compared with
# angle at the object between a photograph and those it is compared with: less says little about
# depth, more changes what is seen
_BASELINE_DEGREES = 14.0


def angles_between(positions: NDArray[np.float64]) -> NDArray[np.float64]:
    """Angles (V, V), degrees, between camera centres (V, 3) as seen from the origin."""
    towards = positions / np.linalg.norm(positions, axis=1, keepdims=True)
    return np.degrees(np.arccos(np.clip(towards @ towards.T, -1.0, 1.0)))


def choose_sources(positions: NDArray[np.float64]) -> list[NDArray[np.int64]]:
    """For each photograph, others at a good angle from it that lie on different sides of it.

    Args:
        positions: (V, 3) camera centres, unit frame.

    Returns:
        Indices, at most `config.sources` for each photograph, the best first.
    """
    angle = angles_between(positions)
    spread = np.where(angle < _BASELINE_DEGREES, _NARROW, _WIDE) * _BASELINE_DEGREES
    fits = np.exp(-(((angle - _BASELINE_DEGREES) / spread) ** 2))
    np.fill_diagonal(fits, 0.0)
    chosen = []
    for own in fits:
        score, picked = own.copy(), []
        while len(picked) < _SOURCES and score.max() > _LEAST_SCORE:
            best = int(score.argmax())
            picked.append(best)
            score *= 1.0 - np.exp(-((angle[best] / (_APART * _BASELINE_DEGREES)) ** 2))
        chosen.append(np.array(picked, np.int64))
    return chosen
