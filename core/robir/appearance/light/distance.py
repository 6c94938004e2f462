# SPDX-License-Identifier: Apache-2.0
"""How far away the light is: a sky infinitely, the windows, lamps and walls of a room not.

Light that comes from a sphere about the thing shines on each point from elsewhere, and that of a
lamp falls off across the thing. Taken for one from afar it would leave the near side of one paint
brighter than the far side.
"""

from __future__ import annotations

from dataclasses import replace

from robir.appearance.config import AppearanceConfig
from robir.appearance.light.lobes import NO_PRIOR
from robir.appearance.light.problem import Problem
from robir.appearance.light.solver import Light, refit
from robir.appearance.light.sun_search import find_suns, polish
from robir.workers import side_by_side

_ROOM = 6.0  # radius that is tried first, radii of the thing
_OTHERS = (12.0, 4.0)  # that are tried once this one explains more than light from afar
_LEAST_GAIN = 0.01  # share by which it must lower the neighbour loss; a sky is taken for no room


def with_distance(
    problem: Problem, light: Light, config: AppearanceConfig, seed: int
) -> tuple[Problem, Light, float]:
    """The problem and its light from where it explains most; with the neighbour loss from afar.

    Once it is near, suns are searched anew: what a lamp shades from near by points elsewhere for a
    sun. One that the user knows is taken for a sun.
    """

    def lit_from(distance: float) -> Problem:
        return replace(problem, scene=problem.scene.lit_from(distance))

    def solved(scene: Problem, start: Light) -> tuple[Problem, Light]:
        solution = refit(scene, start, NO_PRIOR, config)
        return scene, replace(solution, history=light.history)

    if problem.scene.sun is not None:
        return *solved(problem, light), light.loss
    # by the same suns: a loss without any compares other pairs
    scenes = problem, (room := lit_from(_ROOM))
    (_, afar), best = side_by_side(lambda scene: solved(scene, light), scenes)
    if best[1].loss > (1 - _LEAST_GAIN) * afar.loss:
        return problem, afar, afar.loss
    start = light
    if len(light.axes):
        found = find_suns(room, config, seed)
        moved = polish(room, found if len(found.axes) else light, config, seed)
        again = solved(room, moved)
        if again[1].loss < best[1].loss:
            best, start = again, moved
    others = [lit_from(distance) for distance in _OTHERS]
    trials = side_by_side(lambda scene: solved(scene, start), others)
    return *min((best, *trials), key=lambda trial: trial[1].loss), afar.loss
