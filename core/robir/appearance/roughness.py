# SPDX-License-Identifier: Apache-2.0
"""How many roughnesses the paint of an object has: none, one, or one per material.

What highlights leave unexplained is known for every sample at every roughness. The samples are held
out by blocks of the surface: a roughness is found on the others and judged on these, each with its
own diffuse colour, as under any other roughness. Of no highlights at all, one roughness, and one
per material the simplest is taken within one standard error of the best.

Views of a sample could be held out instead, but where the mesh is a few degrees off, a sharp
highlight is predicted beside the true one and counts twice: a wide one wins on every mesh.
"""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robir.appearance.blocks import Table, block_numbers, difference_error, mean_of, table_of
from robir.appearance.choice import Choice

Floats = NDArray[np.float32]

LEVELS = (0.12, 0.2, 0.3, 0.42, 0.56, 0.72, 0.9)
"""Roughnesses that are tried."""

UNKNOWN = 0.5
"""Roughness given to what the views say nothing about."""

MATTE = 1.0
"""Roughness stated for paint without highlights; it has no bearing on how it looks."""

FIRST_SHOWN = 2
"""First level whose highlight is wide enough for a few dozen views to show it."""

SHARP_LEAD = 0.8
"""Cost of a sharper level against the best of the rough ones at which it is believed."""

MATTE_LEAD = 0.4
"""Cost without any highlight against the best with one at which a material is as rough as can be:
a highlight too sharp for any view to show fits a matte surface nearly as well as none."""

MIN_HIGHLIGHTS = 100
"""Views near a sun's mirror direction that a material must have for its roughness to be judged."""

MISFIT = 0.03
"""Display error that the best roughness leaves where the mesh is wrong; under a right mesh it is
0.01 to 0.02. Wide highlights hide such errors, so that a rough material is not believed there."""

FOLDS = 5
"""Parts of the surface that are held out in turn."""

ONE, EACH = "one for the whole object", "one per material"
GLOSSY, DULL = "as of any paint: F0 = 0.04", "none"


@dataclass(frozen=True, slots=True)
class Highlights:
    """Display errors of samples in the views near a sun's mirror direction.

    Attributes:
        error: (U, L) sum over these views at every level.
        plain: (U,) the same without any highlight.
        count: (U,) number of such views.
    """

    error: Floats
    plain: Floats
    count: Floats

    def of(self, chosen: NDArray[np.bool_]) -> Highlights:
        """Some of the samples."""
        return Highlights(self.error[chosen], self.plain[chosen], self.count[chosen])


@dataclass(frozen=True, slots=True, kw_only=True)
class RoughnessChoice:
    """What was chosen.

    Attributes:
        has_highlights: Whether anything but metal has a specular layer.
        roughness: (K,) of every material.
        choices: What was chosen against what, for the report.
    """

    has_highlights: bool
    roughness: NDArray[np.float64]
    choices: tuple[Choice, ...]


def choose_roughness(
    highlights: Highlights, material: NDArray[np.int64], position: Floats, num_materials: int
) -> RoughnessChoice:
    """Take no more roughnesses than the samples ask for.

    Args:
        highlights: Of the samples that are no metal.
        material: (U,) material of each, below `num_materials`.
        position: (U, 3) unit frame.
        num_materials: K; some may have none of these samples.

    Returns:
        The choice.
    """
    started = time.process_time()
    is_believed = _believed(highlights, material, num_materials)
    usable = is_believed[material]
    highlights, material, position = highlights.of(usable), material[usable], position[usable]
    one, each = _fitted(highlights, material, num_materials)
    each[~is_believed] = UNKNOWN
    if highlights.count.sum() < MIN_HIGHLIGHTS:
        why = "no highlight of a sun is seen that could tell"
        choices = (
            Choice(choice="specular", chosen=GLOSSY, alternatives=(DULL,), why=why),
            Choice(choice="roughness", chosen=ONE, alternatives=(EACH,), why=why),
        )
        return RoughnessChoice(has_highlights=True, roughness=each, choices=choices)
    block = block_numbers(position)
    judged = [
        _table(block, errors, highlights.count)
        for errors in _held_out(highlights, material, num_materials, block)
    ]
    plain, single, several = judged
    best = min(judged, key=mean_of)
    is_dull = _within_one_error(plain, best)
    is_one = is_dull or _within_one_error(single, several)
    roughness = np.full(num_materials, MATTE if is_dull else one) if is_one else each
    chosen = single if is_one else several
    choices = (
        Choice(
            choice="specular",
            chosen=DULL if is_dull else GLOSSY,
            alternatives=(GLOSSY if is_dull else DULL,),
            held_out_error=255 * mean_of(plain if is_dull else chosen),
            why=_reason(plain, best, "none"),
        ),
        Choice(
            choice="roughness",
            chosen=ONE if is_one else EACH,
            alternatives=(EACH if is_one else ONE,),
            held_out_error=255 * mean_of(chosen),
            cost_seconds=time.process_time() - started,
            why=_reason(single, several, "one"),
        ),
    )
    return RoughnessChoice(has_highlights=not is_dull, roughness=roughness, choices=choices)


def _believed(
    highlights: Highlights, material: NDArray[np.int64], num_materials: int
) -> NDArray[np.bool_]:
    """Materials (K,) whose roughness is believed as far as it is judged."""
    is_believed = np.ones(num_materials, bool)
    for index in range(num_materials):
        own = highlights.of(material == index)
        misfits = own.error.sum(0).min() > MISFIT * own.count.sum()
        is_believed[index] = not misfits or _roughness(own, 0.0) <= UNKNOWN
    return is_believed


def _fitted(
    highlights: Highlights, material: NDArray[np.int64], num_materials: int
) -> tuple[float, NDArray[np.float64]]:
    """Roughness of all samples together, and of every material (K,).

    What is judged of the object says something of a material that is not: it gets half of that.
    """
    one = _roughness(highlights, UNKNOWN)
    half = (one + UNKNOWN) / 2
    each = [_roughness(highlights.of(material == index), half) for index in range(num_materials)]
    return one, np.array(each)


def _roughness(highlights: Highlights, unjudged: float) -> float:
    """Roughness of samples that share it; `unjudged` where too few views tell."""
    if highlights.count.sum() < MIN_HIGHLIGHTS:
        return unjudged
    curve = highlights.error.sum(0)
    if highlights.plain.sum() < MATTE_LEAD * curve.min():
        return LEVELS[-1]
    return lowest_cost(curve)


def lowest_cost(curve: Floats) -> float:
    """Roughness at the minimum of a parabola through the lowest level and its neighbours.

    A highlight too sharp for any view to show and one too wide to stand out predict the same
    photographs; unless the sharp one does much better it is not believed.

    Args:
        curve: (L,) costs of the levels.
    """
    best = int(curve.argmin())
    if best < FIRST_SHOWN and curve[best] > SHARP_LEAD * curve[FIRST_SHOWN + 1 :].min():
        best = FIRST_SHOWN + int(curve[FIRST_SHOWN:-1].argmin())
    if best in (0, len(curve) - 1):
        return LEVELS[best]
    around = slice(best - 1, best + 2)
    square, slope, _ = np.polyfit(LEVELS[around], curve[around].astype(np.float64), 2)
    vertex = -slope / (2 * square) if square > 0 else LEVELS[best]
    return float(np.clip(vertex, LEVELS[best - 1], LEVELS[best + 1]))


def _held_out(
    highlights: Highlights,
    material: NDArray[np.int64],
    num_materials: int,
    block: NDArray[np.int64],
) -> tuple[Floats, Floats, Floats]:
    """Errors (U,) without highlights, with one roughness, and with one per material.

    No sample's own errors take part in the roughnesses it is judged under.
    """
    fold = np.random.default_rng(0).integers(0, FOLDS, block.max() + 1)[block]
    roughness = np.zeros((2, len(block)))
    for held_out in range(FOLDS):
        out = fold == held_out
        one, each = _fitted(highlights.of(~out), material[~out], num_materials)
        roughness[:, out] = np.stack([np.full(out.sum(), one), each[material[out]]])
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


def _within_one_error(simple: Table, rich: Table) -> bool:
    """Whether the simple model predicts as well as the other within one standard error."""
    return mean_of(simple) - mean_of(rich) <= difference_error(simple, rich)


def _reason(simple: Table, rich: Table, name: str) -> str:
    """The figures of a choice, in words."""
    more, error = mean_of(simple) - mean_of(rich), difference_error(simple, rich)
    return (
        f"display error near highlights, of parts of the surface that were not fitted, is "
        f"{255 * more:+.2f} codes with {name}, standard error {255 * error:.2f}; the simplest "
        "within one standard error"
    )
