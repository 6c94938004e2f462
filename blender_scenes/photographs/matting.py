# SPDX-License-Identifier: GPL-3.0-or-later
"""Masks as users bring them: right, or a pixel or two too large or too small, by a wavy line."""

import numpy as np
from scipy.ndimage import distance_transform_edt, gaussian_filter

WAVE = 12.0
"""Pixels over which the line wanders."""

WANDERING = 0.6
"""Pixels, standard deviation."""


def mask(coverage: np.ndarray) -> np.ndarray:
    """The right mask (H, W) uint8, 0 or 255, of a coverage (H, W)."""
    return np.where(coverage > 0.5, 255, 0).astype(np.uint8)


def wavy_mask(coverage: np.ndarray, growth: float, seed: int) -> np.ndarray:
    """A mask that is off.

    Args:
        coverage: (H, W).
        growth: pixels by which it is too large, below 0 too small.
        seed: of the line's waves.

    Returns:
        (H, W) uint8, 0 or 255.
    """
    inside = coverage > 0.5
    if not inside.any():
        return mask(coverage)
    away = distance_transform_edt(~inside) - distance_transform_edt(inside)
    wave = gaussian_filter(np.random.default_rng(seed).normal(size=coverage.shape), WAVE)
    wave *= WANDERING / max(float(wave.std()), 1e-9)
    # pixels are at distance 1 or more, on either side of the outline
    line = growth + wave
    return np.where(away - 0.5 * np.sign(away) <= line, 255, 0).astype(np.uint8)
