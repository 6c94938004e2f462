# SPDX-License-Identifier: Apache-2.0
"""Which photographs a photograph is compared with."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from robir.geometry.stereo.config import StereoConfig


def angles_between(positions: NDArray[np.float64]) -> NDArray[np.float64]:
    """Angles (V, V), degrees, between camera centres (V, 3) as seen from the origin."""
    towards = positions / np.linalg.norm(positions, axis=1, keepdims=True)
    return np.degrees(np.arccos(np.clip(towards @ towards.T, -1.0, 1.0)))


def choose_sources(positions: NDArray[np.float64], config: StereoConfig) -> list[NDArray[np.int64]]:
    """For each photograph, others at a good angle from it that lie on different sides of it.

    Args:
        positions: (V, 3) camera centres, unit frame.
        config: How many, and the best angle.

    Returns:
        Indices, at most `config.sources` for each photograph, the best first.
    """
    wanted, rule = config.baseline_degrees, config.source_choice
    angle = angles_between(positions)
    spread = np.where(angle < wanted, rule.narrow, rule.wide) * wanted
    fits = np.exp(-(((angle - wanted) / spread) ** 2))
    np.fill_diagonal(fits, 0.0)
    chosen = []
    for own in fits:
        score, picked = own.copy(), []
        while len(picked) < config.sources and score.max() > rule.least_score:
            best = int(score.argmax())
            picked.append(best)
            score *= 1.0 - np.exp(-((angle[best] / (rule.apart * wanted)) ** 2))
        chosen.append(np.array(picked, np.int64))
    return chosen
