# SPDX-License-Identifier: Apache-2.0
"""Which of the parts that may be metal are metal: those that this predicts better than paint."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from robir.appearance.choice import Choice
from robir.appearance.highlights import LEVELS
from robir.appearance.metal import MetalParts
from robir.appearance.trial import Trial

Floats = NDArray[np.float32]


def proven_parts(parts: MetalParts, trial: Trial, dielectric: Floats) -> tuple[MetalParts, Choice]:
    """The parts of which photographs that had no part in their fit prove that they are metal.

    Each is compared with paint, matt or of the roughness that fits it best, whichever is better;
    in the end all of them together are.

    Args:
        parts: As read from the fitted views.
        trial: The U samples in all views.
        dielectric: (U, L) display error of each sample as paint at every roughness, in those.

    Returns:
        The proven parts, numbered anew, and what was compared, for the report.
    """
    count = len(trial.kept[0].sample)
    plain, metal, proven = np.zeros(count), np.zeros(count), np.zeros(len(parts.base), bool)
    for index, base in enumerate(parts.base):
        inside = parts.part == index
        kept = trial.kept_of(inside)
        level = LEVELS[int(dielectric[inside].mean(0).argmin())]
        glossy = trial.paint_errors(kept, np.full(len(inside), level))
        plain[kept] = min(trial.paint_errors(kept, None), glossy, key=np.sum)
        metal[kept] = trial.metal_errors(kept, base, float(parts.roughness[index]))
        proven[index] = trial.proof(kept, plain[kept], metal[kept]).is_given
    kept = trial.kept_of(np.append(proven, False)[parts.part])
    whole = trial.proof(kept, plain[kept], metal[kept])
    told = f"of {len(proven)} parts that may be metal {proven.sum()} are predicted better so"
    if proven.any():
        told += f"; as a whole {whole.words}"
    if not whole.is_given:
        proven[:] = False
    number = np.append(np.where(proven, np.cumsum(proven) - 1, -1), -1)
    choice = Choice(
        choice="metal",
        chosen=f"{(number[parts.part] >= 0).mean():.0%} of the surface",
        alternatives=("none",),
        held_out_error=whole.rich if proven.any() else None,
        why=told,
    )
    kept_parts = MetalParts(
        part=number[parts.part], base=parts.base[proven], roughness=parts.roughness[proven]
    )
    return kept_parts, choice
