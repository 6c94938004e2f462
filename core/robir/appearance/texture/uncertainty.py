# SPDX-License-Identifier: Apache-2.0
"""How well the albedo of a texel is known: one standard error of its natural logarithm.

The causes of an error hardly depend on each other, so their variances add:

    e^2 = floor^2 + (spread s)^2 + (changed c)^2 + few^2 / n + (distance d)^2

with s the standard error of the views about the texel's brightness, c how far smoothing changed its
albedo, n the number of views and d the distance to the nearest texel that has any. The factors make
bands of e hold 90 % of the texels of captures with known albedo within 1.645 e, up to one factor a
channel for the whole object (docs/uncertainty.md).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from robir.workers import num_workers

Floats = NDArray[np.float32]

LARGEST = 1.0  # from here on the albedo is unknown; code 255 of uncertainty.png

_FLOOR = 0.14  # what every texel has: light that is wrong makes whole sides of a thing wrong alike
_SPREAD = 4.3  # factor of the standard error of the views about a texel's brightness
_CHANGED = 2.4  # factor of how far albedo lay off its surroundings
_FEW = 0.19  # error by one view; falls with the square root of their number
# of a texel that no view shows, per unit frame to the nearest seen one. Assumed, not calibrated:
# test views hardly show what no training view does.
_DISTANCE = 14.0


def standard_error(
    spread: Floats, changed: Floats, count: NDArray[np.integer[Any]], distance: Floats
) -> Floats:
    """One standard error (N,) of log albedo, float32 in [floor, LARGEST].

    `spread` (N,) is the standard error over the views of the log of a texel's brightness, `changed`
    (N,) the absolute change of log albedo by smoothing, mean over channels, `count` (N,) the views
    that show it, `distance` (N,) that to the nearest texel that a view shows, unit frame.
    """
    variance = _FLOOR**2 + (_SPREAD * spread) ** 2 + (_CHANGED * changed) ** 2
    variance = variance + _FEW**2 / np.maximum(count, 1)
    variance = variance + (_DISTANCE * distance) ** 2
    return np.minimum(np.sqrt(variance), LARGEST).astype(np.float32)


def distance_to_seen(position: Floats, seen: NDArray[np.bool_]) -> Floats:
    """Distance of every point (N, 3) to the nearest that is seen.

    Infinite if none is, and from where it alone makes an albedo unknown: these cost most.
    """
    distance = np.where(seen, 0.0, np.inf).astype(np.float32)
    if seen.any() and not seen.all():
        tree = cKDTree(position[seen])
        reach = LARGEST / _DISTANCE
        distance[~seen] = tree.query(
            position[~seen], eps=0.1, distance_upper_bound=reach, workers=num_workers()
        )[0]
    return distance
