# SPDX-License-Identifier: Apache-2.0
"""Which of the parts that may be metal are metal: those that this predicts better than paint."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from robir.appearance.material.highlights import LEVELS
from robir.appearance.material.metal import MetalParts
from robir.appearance.material.trial import Trial
from robir.jobs.context import Choice

Floats = NDArray[np.float32]


def proven_parts(parts: MetalParts, trial: Trial, dielectric: Floats) -> tuple[MetalParts, Choice]:
    """The parts that are metal unless photographs that had no part in their fit prove the contrary.

    Each is compared with a dielectric, matt or of the roughness that fits it best, whichever is
    better. What metal mirrors is displaced by normals that are a few degrees off, and squared
    errors count that twice, so that true metal is hardly ever proven.

    Args:
        parts: As read from the photographs.
        trial: The U samples.
        dielectric: (U, L) display error of each sample as paint at every roughness, in those.

    Returns:
        The proven parts, numbered anew, and what was compared, for the report.
    """
    count = len(trial.rays.sample)
    plain, metal, single = np.zeros(count), np.zeros(count), []
    for index, roughness in enumerate(parts.roughness):
        inside = parts.part == index
        own = trial.rays_of(inside)
        level = LEVELS[int(dielectric[inside].mean(0).argmin())]
        glossy = trial.paint_errors(own, np.full(len(inside), level))
        plain[own] = min(trial.paint_errors(own, None), glossy, key=np.sum)
        metal[own] = trial.metal_errors(own, float(roughness))
        single.append(trial.proof(own, plain[own], metal[own]))
    every = trial.rays_of(parts.part >= 0)
    whole = trial.proof(every, plain[every], metal[every])
    proven = np.array([one.is_open for one in single], bool)
    told = f"of {len(proven)} parts that may be metal {proven.sum()} are not disproven"
    if len(proven):
        told += f"; of all together {whole.words}"
    kept_parts = parts.of(proven)
    choice = Choice(
        choice="metal",
        chosen=f"{(kept_parts.part >= 0).mean():.0%} of the surface",
        alternatives=("none",),
        held_out_error=whole.rich if proven.all() and len(proven) else None,
        why=told,
    )
    return kept_parts, choice
