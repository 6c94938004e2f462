# SPDX-License-Identifier: Apache-2.0
"""Held-out test of parts that may be metal."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from robir.appearance.material.highlights import LEVELS
from robir.appearance.material.metal import MetalParts
from robir.appearance.material.trial import MaterialTrial
from robir.jobs.context import Choice

Floats = NDArray[np.float32]


def tested_parts(
    parts: MetalParts, trial: MaterialTrial, dielectric: Floats
) -> tuple[MetalParts, Choice]:
    """The parts (numbered anew) that held-out photographs do not refute as metal, and the choice.

    Each is compared with a dielectric, matt or of its best roughness. As displaced reflections
    count twice in squared errors, true metal is hardly ever proven. `dielectric` (U, L) is the
    display error of each sample at every roughness.
    """
    count = len(trial.rays.sample)
    plain, metal, single = np.zeros(count), np.zeros(count), []
    for index, roughness in enumerate(parts.roughness):
        inside = parts.part == index
        own = trial.rays_of(inside)
        level = LEVELS[int(dielectric[inside].mean(0).argmin())]
        glossy = trial.dielectric_errors(own, np.full(len(inside), level))
        plain[own] = min(trial.dielectric_errors(own, None), glossy, key=np.sum)
        metal[own] = trial.metal_errors(own, float(roughness))
        single.append(trial.compare(own, plain[own], metal[own]))
    every = trial.rays_of(parts.part >= 0)
    whole = trial.compare(every, plain[every], metal[every])
    passed = np.array([one.is_not_worse for one in single], bool)
    why = f"of {len(passed)} parts that may be metal {passed.sum()} are not disproven"
    if len(passed):
        why += f"; of all together {whole.words}"
    kept_parts = parts.of(passed)
    choice = Choice(
        choice="metal",
        chosen=f"{(kept_parts.part >= 0).mean():.0%} of the surface",
        alternatives=("none",),
        held_out_error=whole.rich if passed.all() and len(passed) else None,
        why=why,
    )
    return kept_parts, choice
