# SPDX-License-Identifier: Apache-2.0
"""Whether photographs speak against the suns that were found in them.

A surface that is a percent off casts shadows of its own, and one of thousands of directions fits
those. So the light is solved once more by the sky alone. Two tests compare both: views predicted
from others, and albedo across the suns' shadows. Their standard errors are added as Stouffer's sum
of independent tests (Stouffer et al. 1949, "The American Soldier" I). Suns that views speak for are
not refused by shadows: of pairs that are alike by the sky alone, a strong shadow has none.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from robir.appearance.held_out_test import HeldOutTest, block_numbers, mean_error, mean_of, table_of
from robir.appearance.light.lobes import log_ratio
from robir.appearance.light.solver import Light, refit
from robir.appearance.light.sunlight import LIGHT_ERROR, Sunlight, of_one_material
from robir.appearance.material.trial import MaterialTrial
from robir.appearance.photometry.statistics import Pairs
from robir.appearance.solution import Solution, solve
from robir.appearance.tone.choose import ToneChoice
from robir.appearance.tone.ranking import CODE_ERROR
from robir.jobs.context import Choice
from robir.steps import Pipeline

Reals = NDArray[np.floating[Any]]

_NUM_SAMPLES = 4000  # samples by which views are predicted from others

# by which suns must lead. A convex thing without highlights has no shadow that could tell; its suns
# stay (standard errors)
_MARGIN = -0.5

_FOR = 1.0  # standard errors from which views speak for suns


def with_tested_suns(
    tone: ToneChoice, solution: Solution, sky: Light, pipeline: Pipeline
) -> Solution:
    """The solution, or that under the sky alone where photographs speak against its suns.

    `sky` is the light under the first curve of `tone` without suns.
    """
    number, config = len(solution.light.axes), solution.config
    by_all = refit(solution.matte, sky, solution.prior, config)
    plain = replace(solution, light=replace(by_all, history=(sky.loss,)))
    views = lead_in_errors(compared(plain, solution), CODE_ERROR)
    shadows = lead_across_shadows(plain, solution)
    leads = together(views, shadows)
    is_kept, taken = leads > _MARGIN, solution
    if not is_kept:
        start = replace(sky, history=(sky.loss,))
        problem = tone.candidates[0].problem
        taken = solve(problem, start, config, solution.seed, pipeline)
    choice = Choice(
        choice="suns",
        chosen=number if is_kept else 0,
        alternatives=(0 if is_kept else number,),
        why=f"views predicted from others say {views:+.1f} standard errors for the suns that were "
        f"found, albedos across their shadows {shadows:+.1f}, together {leads:+.1f}; more than "
        f"{_MARGIN:g} are asked for",
    )
    return replace(taken, choices=(*taken.choices, choice))


def together(views: float, shadows: float) -> float:
    """Standard errors for suns, of those by views and across shadows."""
    if views > _FOR:
        shadows = max(shadows, 0.0)
    return (views + shadows) / 2**0.5


def lead_across_shadows(plain: Solution, rich: Solution) -> float:
    """Standard errors by which the second model, with suns, evens albedo across their shadows.

    Across a real shadow that a model does not know, all pairs of one material have a common step.
    The steps that both models leave are compared with their errors: a likelihood ratio of normal
    variables. 0 where the suns cast no shadow.
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


def compared(plain: Solution, rich: Solution) -> HeldOutTest:
    """What views say of two models of one scene, each predicting them from others."""
    scene = plain.problem.scene
    rows = scene.rows[plain.problem.radiance.seen.numpy()[scene.rows]]
    rows = rows[:: -(-len(rows) // _NUM_SAMPLES) or 1]
    (before, views), (after, _) = (prediction_errors(model, rows) for model in (plain, rich))
    return HeldOutTest.of(before, after, (views,))


def prediction_errors(model: Solution, rows: NDArray[np.int64]) -> tuple[Reals, NDArray[np.int64]]:
    """Squared errors (M,) of views of samples (U,), predicted from others, and these views (M,).

    Metal counts as dielectric here: it is the same in both models.
    """
    trial = MaterialTrial.of(model.problem, model.light, rows)
    chosen = trial.rays_of(np.ones(len(rows), bool))
    specular = model.material
    level = specular.roughness[rows].astype(np.float64) if specular.has_highlights else None
    return trial.dielectric_errors(chosen, level), trial.rays.view[chosen.numpy()]


def lead_in_errors(test: HeldOutTest, code_error: float) -> float:
    """By how many standard errors the richer model leads; so many codes are added to each."""
    if not np.isfinite(test.error):
        return 0.0
    # squared errors to codes, about their mean
    error = 255**2 * test.error / max(test.plain + test.rich, 1e-9)
    return (test.plain - test.rich) / float(np.hypot(error, code_error))
