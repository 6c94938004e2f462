# SPDX-License-Identifier: Apache-2.0
"""Photographs that were taken under another light than the rest.

Where a lamp was covered, points are darker than in all other photographs, but not by one factor.
Such photographs say nothing about the light of the rest, and their shadow would be read as albedo.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

# stops by which a photograph must be brighter or darker than the rest: more than highlights make it
LEAST_STOPS = 0.5
# how much of that its points must differ among each other: more than in one exposed otherwise
LEAST_SPREAD = 0.3
# median difference beyond which the rest do not agree themselves: metal, of which all photographs
# differ, comes to 0.35, and so does a light that moves with the camera (log radiance)
_MOST_COMMON_SPREAD = 0.25
_MOST_VIEWS = 0.25  # share of photographs beyond which there is no common light to differ from
_LEAST_POINTS = 20  # points that a photograph must show to be judged


def unlike(log: Array, points: Array) -> NDArray[np.bool_]:
    """Photographs (V,) that show points much brighter or darker, not by one factor.

    Of log radiance (P, V, 3), NaN where not shown, and of the points (P, 3) under the common light.
    """
    return _is_unlike(*_compared(log, points, _LEAST_POINTS))


def find_unlike(log: Array, gains: Array) -> tuple[NDArray[np.bool_], Array]:
    """Photographs (V,) under another light than most, and the points' log radiance (P, 3).

    None where the rest do not agree or are too few. `gains` (V, 3) are from `gains.solve_gains`.
    """
    points = np.nanmedian(log - gains, axis=1) + np.median(gains, axis=0)
    gain, left = _compared(log, points, _LEAST_POINTS)
    odd = _is_unlike(gain, left)
    if odd.mean() > _MOST_VIEWS or not np.nanmedian(left[~odd]) < _MOST_COMMON_SPREAD:
        odd = np.zeros_like(odd)
    return odd, points


def _is_unlike(gain: Array, left: Array) -> NDArray[np.bool_]:
    """Which photographs (V,) are much brighter or darker, and not by one factor."""
    is_far = np.abs(gain) > LEAST_STOPS * np.log(2)
    return is_far & (left > LEAST_SPREAD * np.abs(gain))


def _compared(log: Array, points: Array, least: int) -> tuple[Array, Array]:
    """How much brighter photographs are (V,), and how much their points differ in that (V,).

    Both are 0 of those that show less than `least` points.
    """
    apart = (log - points[:, None]).mean(2)
    apart[:, np.isfinite(apart).sum(0) < least] = 0.0
    gain = np.nanmedian(apart, axis=0)
    return gain, np.nanmedian(np.abs(apart - gain), axis=0)
