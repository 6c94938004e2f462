# SPDX-License-Identifier: Apache-2.0
"""Whether photographs disprove the suns that were found in them.

A sun is searched among thousands of directions by the shadows it would cast, and a surface that is
a percent off casts enough of its own for one of them to fit. So the light is solved once more by
the sky alone, and two witnesses are asked which is nearer the truth: views, predicted from others,
which know of highlights and nothing of shadows; and pairs of samples across the suns' shadows,
whose albedos have no step in common if the shadows are there. What both say is added up as
Stouffer's sum of independent tests (Stouffer et al. 1949, "The American Soldier" I).
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from robir.appearance.blocks import block_numbers, mean_error, mean_of, table_of
from robir.appearance.light.lobes import log_ratio
from robir.appearance.light.shade import LIGHT_ERROR, of_one_material
from robir.appearance.light.solver import Light, refit
from robir.appearance.light.sunlight import Sunlight
from robir.appearance.material.trial import Trial
from robir.appearance.photometry.statistics import Pairs
from robir.appearance.proof import Proof
from robir.appearance.solution import Solution, solve
from robir.appearance.tone.choose import ToneChoice
from robir.appearance.tone.ranking import CODE_ERROR
from robir.jobs.context import Choice
from robir.steps import Course

Reals = NDArray[np.floating[Any]]

_NUM_SAMPLES = 4000
"""Samples by which views are predicted from others."""

# by which suns must lead. A convex thing without highlights has no shadow that could tell; its suns
# stay (standard errors)
_MARGIN = -0.5


def with_proven_suns(tone: ToneChoice, solution: Solution, sky: Light, course: Course) -> Solution:
    """The solution, or that under the sky alone where photographs speak against its suns.

    Args:
        tone: Curves, the taken one first.
        solution: Light and material under that, with suns.
        sky: Light under that without any.
        course: Of the stage's steps.
    """
    number, config = len(solution.light.axes), solution.config
    by_all = refit(solution.matte, sky, solution.told, config)
    plain = replace(solution, light=replace(by_all, history=(sky.loss,)))
    views = lead_in_errors(compared(plain, solution), CODE_ERROR)
    shadows = lead_across_shadows(plain, solution)
    leads = (views + shadows) / np.sqrt(2)
    is_proven, taken = leads > _MARGIN, solution
    if not is_proven:
        start = replace(sky, history=(sky.loss,))
        problem = tone.candidates[0].problem
        taken = solve(problem, start, config, solution.seed, course)
    choice = Choice(
        choice="suns",
        chosen=number if is_proven else 0,
        alternatives=(0 if is_proven else number,),
        why=f"views predicted from others say {views:+.1f} standard errors for the suns that were "
        f"found, albedos across their shadows {shadows:+.1f}, together {leads:+.1f}; more than "
        f"{_MARGIN:g} are asked for",
    )
    return replace(taken, choices=(*taken.choices, choice))


def lead_across_shadows(plain: Solution, rich: Solution) -> float:
    """By how many standard errors the second model evens albedo across its suns' shadows.

    Where a shadow is real and not known, what lies in it is darker than what is lit, by a step that
    all pairs of one material have in common. The steps that both models leave are compared with
    their errors: a likelihood ratio of normal variables.

    Args:
        plain: Light and material without the suns.
        rich: With them.

    Returns:
        Positive for the second; 0 where its suns cast no shadow.
    """
    problem, rows = rich.problem, rich.problem.scene.rows
    parts = Sunlight.of(problem, rich.light.axes).across_shadows()
    pairs = Pairs.joined(parts)
    shaded, lit = pairs.first, pairs.second
    position = problem.scene.transport.surfels.position[rows]
    block = block_numbers(position)[shaded.numpy()]
    jumps, weight = [], torch.ones(len(shaded))
    for model in (plain, rich):
        radiance = model.matte.rows_radiance(rows)
        albedo = log_ratio(radiance.linear, model.light.irradiance(model.matte, rows))
        jumps.append((albedo[lit] - albedo[shaded]).mean(1).numpy())
        # alike in both models: neither chooses the pairs that it is judged by
        alike = of_one_material(parts, albedo, radiance.clipped).weight
        weight *= alike * ~(radiance.clipped[shaded] | radiance.clipped[lit]).any(1)
    tables = [table_of(block, jump, weight.sqrt().numpy()) for jump in jumps]
    before, after = (mean_of(table) for table in tables)
    error = np.hypot(max(mean_error(table) for table in tables), LIGHT_ERROR)
    gain = (before**2 - after**2) / error**2
    return float(np.sign(gain) * np.sqrt(abs(gain)))


def compared(plain: Solution, rich: Solution) -> Proof:
    """What views say of two models of one scene, each predicting them from others."""
    scene = plain.problem.scene
    rows = scene.rows[plain.problem.radiance.seen.numpy()[scene.rows]]
    rows = rows[:: -(-len(rows) // _NUM_SAMPLES) or 1]
    (before, views), (after, _) = (prediction_errors(model, rows) for model in (plain, rich))
    return Proof.of(before, after, (views,))


def prediction_errors(model: Solution, rows: NDArray[np.int64]) -> tuple[Reals, NDArray[np.int64]]:
    """Squared errors (M,) of views of samples (U,), predicted from others, and these views (M,).

    All is paint here, also what is metal: proven or not, it is the same in both models.
    """
    trial = Trial.of(model.problem, model.light, rows)
    chosen = trial.rays_of(np.ones(len(rows), bool))
    gloss = model.material
    level = gloss.roughness[rows].astype(np.float64) if gloss.has_highlights else None
    return trial.paint_errors(chosen, level), trial.rays.view[chosen.numpy()]


def lead_in_errors(proof: Proof, code_error: float) -> float:
    """By how many standard errors the richer model leads; so many codes are added to each."""
    if not np.isfinite(proof.error):
        return 0.0
    # squared errors to codes, about their mean
    error = 255**2 * proof.error / max(proof.plain + proof.rich, 1e-9)
    return (proof.plain - proof.rich) / float(np.hypot(error, code_error))
