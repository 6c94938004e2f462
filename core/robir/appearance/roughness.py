# SPDX-License-Identifier: Apache-2.0
"""How many roughnesses the paint of an object has: none, one, or one per patch of it.

Where highlights cannot tell, one roughness for all is no safer guess than many: most of what is
mirrored is the ground, whose roughness says nothing of the object's. So each patch of like albedo
and place has its own, drawn towards those like it by how little its own highlights say, see
highlights.py. Only where all of them come out alike there is one.

Whether there are any highlights is judged on parts of the surface that were not fitted. Views of a
sample could be held out instead, but where the mesh is a few degrees off, a sharp highlight is
predicted beside the true one and counts twice: a wide one wins on every mesh.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robir.appearance.blocks import Table, block_numbers, difference_error, mean_of, table_of
from robir.appearance.choice import Choice
from robir.appearance.highlights import LEVELS, Highlights, pooled, read

Floats = NDArray[np.float32]
Reals = NDArray[np.floating[Any]]

MATTE = 1.0
"""Roughness stated for paint without highlights; it has no bearing on how it looks."""

MIN_HIGHLIGHTS = 100
"""Views near a sun's mirror direction that an object must have for anything to be judged."""

STEP = 0.02
"""Roughnesses are whole multiples of this: finer differences are below the errors of the readings,
and every one of them has its own pass over its samples."""

NO_DIFFERENCE = 0.04
"""Deviation of the roughness over the surface below which there is one: nobody sees it."""

FOLDS = 5
"""Parts of the surface that are held out in turn."""

ONE, EACH = "one for the whole object", "one per patch of like paint"
GLOSSY, DULL = "as of any paint: F0 = 0.04", "none"


@dataclass(frozen=True, slots=True, kw_only=True)
class RoughnessChoice:
    """What was chosen.

    Attributes:
        has_highlights: Whether anything but metal has a specular layer.
        roughness: (K,) of every patch.
        choices: What was chosen against what, for the report.
    """

    has_highlights: bool
    roughness: NDArray[np.float64]
    choices: tuple[Choice, ...]


@dataclass(frozen=True, slots=True)
class Patches:
    """Parts of the surface that share a roughness each.

    Attributes:
        features: (K, D) log albedo and place of each.
        number: (U,) patch of every sample that is no metal.
        position: (U, 3) of these, unit frame.
    """

    features: Reals
    number: NDArray[np.int64]
    position: Floats


def choose_roughness(highlights: Highlights, patches: Patches) -> RoughnessChoice:
    """Roughness of every patch, as many as there are.

    Args:
        highlights: Of the U samples that are no metal.
        patches: That they lie on.

    Returns:
        The choice.
    """
    started = time.process_time()
    one, each = _fitted(highlights, patches.number, patches.features)
    if highlights.count.sum() < MIN_HIGHLIGHTS:
        why = "no highlight of a sun is seen that could tell"
        choices = (
            Choice(choice="specular", chosen=GLOSSY, alternatives=(DULL,), why=why),
            Choice(choice="roughness", chosen=ONE, alternatives=(EACH,), why=why),
        )
        return RoughnessChoice(has_highlights=True, roughness=each, choices=choices)
    block = block_numbers(patches.position)
    judged = [
        _table(block, errors, highlights.count) for errors in _held_out(highlights, patches, block)
    ]
    plain, single, several = judged
    best = min(judged, key=mean_of)
    is_dull = mean_of(plain) - mean_of(best) <= difference_error(plain, best)
    deviation = float(each[patches.number].std())
    is_one = is_dull or deviation < NO_DIFFERENCE
    roughness = np.full(len(each), MATTE if is_dull else _stepped(one)) if is_one else each
    chosen = single if is_one else several
    choices = (
        Choice(
            choice="specular",
            chosen=DULL if is_dull else GLOSSY,
            alternatives=(GLOSSY if is_dull else DULL,),
            held_out_error=255 * mean_of(plain if is_dull else chosen),
            why="display error near highlights, of parts of the surface that were not fitted, is "
            f"{_compared(plain, best)} with none; the simplest within one standard error",
        ),
        Choice(
            choice="roughness",
            chosen=ONE if is_one else EACH,
            alternatives=(EACH if is_one else ONE,),
            held_out_error=255 * mean_of(chosen),
            cost_seconds=time.process_time() - started,
            why=f"it differs by {deviation:.2f} over the surface, and is one below "
            f"{NO_DIFFERENCE}; the display error near highlights is {_compared(single, several)} "
            "with one",
        ),
    )
    return RoughnessChoice(has_highlights=not is_dull, roughness=roughness, choices=choices)


def _fitted(
    highlights: Highlights, number: NDArray[np.int64], features: Reals
) -> tuple[float, NDArray[np.float64]]:
    """Roughness of all samples together, and of every patch (K,), in whole steps."""
    readings = read(highlights, number, len(features))
    return readings.weighted_mean(), _stepped(pooled(readings, features))


def _stepped(roughness: Any) -> Any:
    """The nearest whole multiples of STEP."""
    return np.round(np.asarray(roughness, np.float64) / STEP) * STEP


def _held_out(
    highlights: Highlights, patches: Patches, block: NDArray[np.int64]
) -> tuple[Floats, Floats, Floats]:
    """Errors (U,) without highlights, with one roughness, and with one per patch.

    No sample's own errors take part in the roughnesses it is judged under.
    """
    fold = np.random.default_rng(0).integers(0, FOLDS, block.max() + 1)[block]
    roughness = np.zeros((2, len(block)))
    for held_out in range(FOLDS):
        out = fold == held_out
        one, each = _fitted(highlights.of(~out), patches.number[~out], patches.features)
        roughness[:, out] = np.stack([np.full(out.sum(), one), each[patches.number[out]]])
    single, several = (_at(highlights.error, values) for values in roughness)
    return highlights.plain, single, several


def _at(errors: Floats, roughness: NDArray[np.float64]) -> Floats:
    """Errors (U, L) at the roughness (U,) of each sample, linear between the levels."""
    levels = np.array(LEVELS)
    lower = np.clip(np.searchsorted(levels, roughness) - 1, 0, len(levels) - 2)
    share = np.clip((roughness - levels[lower]) / np.diff(levels)[lower], 0, 1)
    rows = np.arange(len(errors))
    return (1 - share) * errors[rows, lower] + share * errors[rows, lower + 1]


def _table(block: NDArray[np.int64], errors: Floats, count: Floats) -> Table:
    """Sums of errors (U,) over blocks; every view counts alike."""
    return table_of(block, errors / np.maximum(count, 1), count)


def _compared(simple: Table, rich: Table) -> str:
    """By how much an error is higher, in words."""
    more, error = mean_of(simple) - mean_of(rich), difference_error(simple, rich)
    return f"{255 * more:+.2f} codes (standard error {255 * error:.2f})"
