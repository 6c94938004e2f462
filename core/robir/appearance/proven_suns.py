# SPDX-License-Identifier: Apache-2.0
"""Whether photographs by a camera prove the suns that were found in them.

A sun is searched among thousands of directions by the shadows it would cast, and a surface that is
a percent off casts enough of its own for one of them to fit. So the scene is solved once more under
the sky alone, and two witnesses are asked which is nearer the truth: views, predicted from others
(response.py), which know of highlights and nothing of shadows; and pairs of samples across the
suns' shadows, which differ less in albedo if the shadows are there. What both say is added up as
Stouffer's sum of independent tests (Stouffer et al. 1949, "The American Soldier" I).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from robir.appearance.blocks import block_numbers, difference_error, mean_of, table_of
from robir.appearance.light.lobes import log_ratio
from robir.appearance.light.solver import fit, no_suns
from robir.appearance.light.sunlight import Sunlight
from robir.appearance.photometry.statistics import Pairs
from robir.appearance.response import compared, lead_in_errors
from robir.appearance.solution import Solution, solve
from robir.appearance.tone.choose import ToneChoice
from robir.jobs.choice import Choice
from robir.steps import Course

MARGIN = 2.0
"""Standard errors by which suns must lead: most rooms have none that is as sharp."""


def with_proven_suns(tone: ToneChoice, solution: Solution, course: Course) -> Solution:
    """The solution, or that under the sky alone where photographs by a camera prove no sun.

    Args:
        tone: Curves, the taken one first.
        solution: Light and material under that.
        course: Of the stage's steps.
    """
    number = len(solution.light.axes)
    if not tone.scene.by_camera or not number:
        return solution
    config, problem = solution.config, tone.candidates[0].problem
    sky = fit(problem, *no_suns(), config.iterations)
    plain = solve(problem, replace(sky, history=(sky.loss,)), config, solution.seed, course)
    views = lead_in_errors(compared(plain, solution))
    shadows = lead_across_shadows(plain, solution)
    leads = (views + shadows) / np.sqrt(2)
    is_proven = leads > MARGIN
    taken = solution if is_proven else plain
    choice = Choice(
        choice="suns",
        chosen=number if is_proven else 0,
        alternatives=(0 if is_proven else number,),
        why=f"views predicted from others say {views:+.1f} standard errors for the suns that were "
        f"found, albedos across their shadows {shadows:+.1f}, together {leads:+.1f}; more than "
        f"{MARGIN:g} are asked for",
    )
    return replace(taken, choices=(*taken.choices, choice))


def lead_across_shadows(plain: Solution, rich: Solution) -> float:
    """By how many standard errors the second model evens albedo across its suns' shadows.

    Args:
        plain: Light and material without the suns.
        rich: With them.

    Returns:
        Positive for the second; 0 where its suns cast no shadow.
    """
    problem = rich.problem
    rows = problem.scene.rows
    pairs = Pairs.joined(Sunlight.of(problem, rich.light.axes).across_shadows())
    first, second = pairs.first.numpy(), pairs.second.numpy()
    block = block_numbers(problem.scene.transport.surfels.position[rows])[first]
    tables = []
    for model in (plain, rich):
        radiance = model.matte.rows_radiance(rows)
        albedo = log_ratio(radiance.linear, model.light.irradiance(model.matte, rows)).numpy()
        whole = ~(radiance.clipped[first] | radiance.clipped[second]).any(1).numpy()
        apart = np.abs(albedo[first] - albedo[second]).sum(1)
        tables.append(table_of(block, apart, pairs.weight.numpy() * whole))
    error = difference_error(*tables)
    if not np.isfinite(error) or error <= 0:
        return 0.0
    return (mean_of(tables[0]) - mean_of(tables[1])) / error
