# SPDX-License-Identifier: Apache-2.0
"""Photographs that were taken under another light than the rest.

Where a lamp was covered, by the photographer, say, or by the arm that carries the camera, surface
points are darker than in all other photographs, but not all by one factor, as they would be if the
photograph were only exposed otherwise. Such photographs tell nothing about the light of the rest;
a shadow that is in a few of them only is read as paint where these show a point best.
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
    """Which photographs show points in another light than they have in the rest.

    Args:
        log: (P, V, 3) log radiance, NaN where a photograph does not show a point.
        points: (P, 3) log radiance of the points under the common light, NaN where unknown.

    Returns:
        (V,); True for photographs that are much brighter or darker, and not by one factor.
    """
    return _is_unlike(*_compared(log, points, _LEAST_POINTS))


def find_unlike(log: Array, gains: Array) -> tuple[NDArray[np.bool_], Array]:
    """The photographs under another light than most, and what points are like under that of most.

    Args:
        log: (P, V, 3) log radiance, NaN where a photograph does not show a point.
        gains: (V, 3) log gains of the photographs, from `exposure.solve_gains`.

    Returns:
        (V,), all False where the rest do not agree or are too few; and (P, 3) log radiance.
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

    Both are 0 of those that show less than so many points.
    """
    apart = (log - points[:, None]).mean(2)
    apart[:, np.isfinite(apart).sum(0) < least] = 0.0
    gain = np.nanmedian(apart, axis=0)
    return gain, np.nanmedian(np.abs(apart - gain), axis=0)
