# SPDX-License-Identifier: Apache-2.0
"""A lamp that stands near: it falls off across the thing, and shines on each point from elsewhere.

A desk lamp is three to twelve radii of the thing away. Under a sun from afar its light would leave
the near side of one paint twice as bright as the far side.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from robir.appearance.light.problem import Problem
from robir.appearance.light.solver import Light, fit
from robir.maths.vectors import ring

Floats = NDArray[np.float32]

_DISTANCES = (12.0, 8.0, 6.0, 5.0, 4.0, 3.0)  # that are tried, radii of the thing
# share by which a lamp at one of the first two must lower the neighbour loss for more to be tried
_HINT = 0.02
_LEAST_GAIN = 0.1  # share by which it must in the end; a sun is not taken for a lamp
_RINGS = (0.12, 0.06, 0.03)  # radii of the search for its direction, radians
_TRIALS = 6  # directions on a ring


def with_near_lamp(problem: Problem, light: Light, iterations: int) -> tuple[Problem, Light]:
    """The problem and its light, whose one sun becomes a lamp near by where that explains more.

    Each trial solves all strengths anew, `iterations` steps each.
    """
    if len(light.axes) != 1 or problem.scene.sun is not None:
        return problem, light

    def tried(axis: Floats, distance: float) -> tuple[Problem, Light]:
        near = replace(problem, scene=replace(problem.scene, lamp_distance=distance))
        return near, fit(near, axis[None], light.sharpness, iterations)

    def loss_of(trial: tuple[Problem, Light]) -> float:
        return trial[1].loss

    axis = light.axes[0]
    _, afar = tried(axis, np.inf)
    best = min((tried(axis, distance) for distance in _DISTANCES[:2]), key=loss_of)
    if loss_of(best) > (1 - _HINT) * afar.loss:
        return problem, light
    for turn, reach in enumerate(_RINGS):
        axis, distance = best[1].axes[0], best[0].scene.lamp_distance
        around = ring(axis, reach, _TRIALS, 0.5 * turn).astype(np.float32)
        best = min((best, *(tried(one, distance) for one in around)), key=loss_of)
        axis = best[1].axes[0]
        others = [tried(axis, other) for other in _DISTANCES if other != distance]
        best = min((best, *others), key=loss_of)
    near, lamp = best
    if lamp.loss > (1 - _LEAST_GAIN) * afar.loss:
        return problem, light
    return near, replace(lamp, history=light.history)
