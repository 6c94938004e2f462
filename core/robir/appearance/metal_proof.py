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
Reals = NDArray[np.float64]


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
    compared: list[tuple[int, Reals, Reals]] = []
    for index, base in enumerate(parts.base):
        inside = parts.part == index
        kept = trial.kept_of(inside)
        level = LEVELS[int(dielectric[inside].mean(0).argmin())]
        glossy = trial.paint_errors(kept, np.full(len(inside), level))
        plain = min(trial.paint_errors(kept, None), glossy, key=np.sum)
        metal = trial.metal_errors(kept, base, float(parts.roughness[index]))
        if trial.proof(kept, plain, metal).is_given:
            compared.append((index, plain, metal))
    proven = np.array([index for index, *_ in compared], np.int64)
    kept = trial.kept_of(np.isin(parts.part, proven))
    order = np.argsort(parts.part[trial.kept[0].sample[kept.numpy()]], kind="stable")
    joined = [np.concatenate([np.zeros(0), *column]) for column in list(zip(*compared))[1:]]
    plain, metal = joined or (np.zeros(0), np.zeros(0))
    whole = trial.proof(kept[order], plain, metal)
    if not whole.is_given:
        proven = proven[:0]
    number = np.full(len(parts.base) + 1, -1)
    number[proven] = np.arange(len(proven))
    choice = Choice(
        choice="metal",
        chosen=f"{np.isin(parts.part, proven).mean():.0%} of the surface",
        alternatives=("none",),
        held_out_error=whole.rich if len(proven) else None,
        why=f"of {len(parts.base)} parts that may be metal {len(compared)} are predicted better so"
        + (f"; as a whole {whole.words}" if compared else ""),
    )
    kept_parts = MetalParts(
        part=number[parts.part], base=parts.base[proven], roughness=parts.roughness[proven]
    )
    return kept_parts, choice
