# SPDX-License-Identifier: Apache-2.0
"""How many roughnesses an object's dielectrics have: none, one, or one per patch.

Each patch of like albedo and place has its own, drawn towards those like it by how little its own
highlights say (highlights.py): one for all would be mostly the ground's. Whether there is a
specular layer, and more than one roughness, is decided by held-out photographs.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robir.appearance.material.highlights import STEP, UNKNOWN, Highlights, pooled, read
from robir.appearance.material.trial import MaterialTrial
from robir.jobs.context import Choice

Floats = NDArray[np.float32]
Reals = NDArray[np.floating[Any]]

MATTE = 1.0  # roughness of paint that reflects, but as dully as it can
# roughness stated for paint without a specular layer: what such paint usually has. It has no
# bearing on how it looks.
USUAL = 0.7

ONE, EACH = "one for the whole object", "one per patch of like paint"
WITH_SPECULAR, WITHOUT_SPECULAR = "as of any paint: F0 = 0.04", "none"

# deviation of the roughness over the surface below which there is one: nobody sees it, and chance
# alone lets patches predict a little better
_NO_DIFFERENCE = 0.04
# standard errors by which a specular layer, or roughness by patch, may lag before it is disproven
_NOT_WORSE = -1.0
_STRIDE = 3  # every so manieth sample of paint is tried


@dataclass(frozen=True, slots=True, kw_only=True)
class RoughnessChoice:
    """What was chosen."""

    has_highlights: bool  # whether anything but metal has a specular layer
    roughness: NDArray[np.float64]  # (K,) of every patch
    choices: tuple[Choice, ...]  # what was chosen against what, for the report


@dataclass(frozen=True, slots=True)
class RoughnessPatches:
    """Parts of the surface that share a roughness each."""

    features: Reals  # (K, D) log albedo and place of each
    number: NDArray[np.int64]  # (U,) patch of every sample


def choose_roughness(
    highlights: Highlights,
    patches: RoughnessPatches,
    trial: MaterialTrial,
    dielectric: NDArray[np.bool_],
) -> RoughnessChoice:
    """Roughness of every patch, as many as held-out tests allow, by `dielectric` (U,) samples."""
    started = time.process_time()
    one, each = _fitted(highlights.of(dielectric), patches.number[dielectric], patches.features)
    kept = trial.rays_of(dielectric & (np.arange(len(dielectric)) % _STRIDE == 0))
    levels = np.full(len(dielectric), _stepped(one, STEP)), each[patches.number]
    plain = trial.dielectric_errors(kept, None)
    single, several = (trial.dielectric_errors(kept, level) for level in levels)
    many = trial.compare(kept, single, several)
    specular = trial.compare(kept, plain, several if many.leads_by(_NOT_WORSE) else single)
    of_dielectric = each[patches.number[dielectric]]
    is_alike = not len(of_dielectric) or float(of_dielectric.std()) < _NO_DIFFERENCE
    is_dull = not specular.leads_by(_NOT_WORSE)
    is_one = is_dull or is_alike or not many.leads_by(_NOT_WORSE)
    roughness = np.full(len(each), USUAL if is_dull else _stepped(one, STEP)) if is_one else each
    choices = (
        Choice(
            choice="specular",
            chosen=WITHOUT_SPECULAR if is_dull else WITH_SPECULAR,
            alternatives=(WITH_SPECULAR if is_dull else WITHOUT_SPECULAR,),
            held_out_error=specular.plain if is_dull else specular.rich,
            why=f"with a specular layer {specular.words(_NOT_WORSE)}",
        ),
        Choice(
            choice="roughness",
            chosen=ONE if is_one else EACH,
            alternatives=(EACH if is_one else ONE,),
            held_out_error=many.plain if is_one else many.rich,
            cost_seconds=time.process_time() - started,
            why=f"with one per patch {many.words(_NOT_WORSE)}",
        ),
    )
    return RoughnessChoice(has_highlights=not is_dull, roughness=roughness, choices=choices)


def _fitted(
    highlights: Highlights, number: NDArray[np.int64], features: Reals
) -> tuple[float, NDArray[np.float64]]:
    """Roughness of all samples together, and of every patch (K,), in whole steps."""
    readings = read(highlights, number, len(features))
    each = _stepped(pooled(readings, features), STEP)
    return readings.weighted_mean(UNKNOWN), each


def _stepped(roughness: Any, step: float) -> Any:
    """The nearest whole multiples of a step."""
    return np.round(np.asarray(roughness, np.float64) / step) * step
