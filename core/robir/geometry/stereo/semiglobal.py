# SPDX-License-Identifier: Apache-2.0
"""Semi-global matching: the depths of a picture that are likely and hang together.

Hirschmueller 2008, "Stereo processing by semiglobal matching and mutual information", eq. 13,
along the two rows and the two columns through each pixel.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float32]


def _along(lines: Iterable[Floats], sums: Iterable[Floats], penalties: tuple[float, float]) -> None:
    """Add the costs (N, D) of the best paths that reach each line from the one before, in place."""
    small, large = penalties
    before: Floats | None = None
    for line, total in zip(lines, sums, strict=True):
        path = line.copy()
        if before is not None:
            least = before.min(axis=1, keepdims=True)
            best = np.minimum(before, least + large)
            np.minimum(best[:, 1:], before[:, :-1] + small, out=best[:, 1:])
            np.minimum(best[:, :-1], before[:, 1:] + small, out=best[:, :-1])
            path += best
            path -= least
        total += path
        before = path


def aggregate(cost: Floats, penalties: tuple[float, float]) -> Floats:
    """Mean costs (H, W, D) over four directions of the best paths through a pixel at a label."""
    total = np.zeros_like(cost)
    for costs, sums in ((cost, total), (cost.swapaxes(0, 1), total.swapaxes(0, 1))):
        _along(costs, sums, penalties)
        _along(costs[::-1], sums[::-1], penalties)
    return total / 4


def refined_minimum(cost: Floats) -> tuple[NDArray[np.int64], Floats]:
    """Label (H, W) of the least cost (H, W, D), and the same between labels by a parabola."""
    label = cost.argmin(axis=2)
    middle = np.clip(label, 1, cost.shape[2] - 2)
    low, mid, high = (
        np.take_along_axis(cost, (middle + step)[..., None], axis=2)[..., 0] for step in (-1, 0, 1)
    )
    bend = low + high - 2 * mid
    shift = np.where(bend > 1e-6, (low - high) / (2 * np.maximum(bend, 1e-6)), 0.0).clip(-0.5, 0.5)
    return label, np.where(label == middle, middle + shift, label).astype(np.float32)


def label_spread(cost: Floats, temperature: float) -> Floats:
    """Deviation (H, W), labels, of a label whose likelihood is exp(-cost / temperature)."""
    weight = np.exp((cost.min(axis=2, keepdims=True) - cost) / temperature)
    weight /= weight.sum(axis=2, keepdims=True)
    label = np.arange(cost.shape[2], dtype=np.float32)
    mean = weight @ label
    return np.sqrt(np.maximum(weight @ label**2 - mean**2, 0.0))
