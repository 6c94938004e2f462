# SPDX-License-Identifier: Apache-2.0
"""Whether photographs by a camera prove the suns that were found in them.

A sun is searched among thousands of directions by the shadows it would cast, and a surface that is
a percent off casts enough of its own for one of them to fit. So the scene is solved once more under
the sky alone, and two witnesses are asked which is nearer the truth: views, predicted from others
(response.py), which know of highlights and nothing of shadows; and pairs of samples across the
suns' shadows, whose albedos have no step in common if the shadows are there. What both say is added
up as Stouffer's sum of independent tests (Stouffer et al. 1949, "The American Soldier" I).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch

from robir.appearance.blocks import block_numbers, mean_error, mean_of, table_of
from robir.appearance.light.lobes import log_ratio
from robir.appearance.light.shade import of_one_material
from robir.appearance.light.solver import fit, no_suns
from robir.appearance.light.sunlight import Sunlight
from robir.appearance.photometry.statistics import Pairs
from robir.appearance.response import compared, lead_in_errors
from robir.appearance.solution import Solution, solve
from robir.appearance.tone.choose import ToneChoice
from robir.jobs.choice import Choice
from robir.steps import Course


def with_proven_suns(tone: ToneChoice, solution: Solution, course: Course) -> Solution:
    """The solution, or that under the sky alone where photographs by a camera prove no sun.

    Args:
        tone: Curves, the taken one first.
        solution: Light and material under that.
        course: Of the stage's steps.
    """
    number = len(solution.light.axes)
    if not tone.scene.by_camera or not number or tone.scene.sun is not None:
        return solution
    config, problem = solution.config, tone.candidates[0].problem
    sky = fit(problem, *no_suns(), config.iterations)
    plain = solve(problem, replace(sky, history=(sky.loss,)), config, solution.seed, course)
    views = lead_in_errors(compared(plain, solution), config.tone.code_error)
    shadows = lead_across_shadows(plain, solution)
    leads = (views + shadows) / np.sqrt(2)
    is_proven = leads > config.proven_suns.margin
    taken = solution if is_proven else plain
    choice = Choice(
        choice="suns",
        chosen=number if is_proven else 0,
        alternatives=(0 if is_proven else number,),
        why=f"views predicted from others say {views:+.1f} standard errors for the suns that were "
        f"found, albedos across their shadows {shadows:+.1f}, together {leads:+.1f}; more than "
        f"{config.proven_suns.margin:g} are asked for",
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
    problem, config = rich.problem, rich.config
    rows = problem.scene.rows
    parts = Sunlight.of(problem, rich.light.axes).across_shadows()
    pairs = Pairs.joined(parts)
    shaded, lit = pairs.first, pairs.second
    position = problem.scene.transport.surfels.position[rows]
    block = block_numbers(position, config.blocks)[shaded.numpy()]
    jumps, weight = [], torch.ones(len(shaded))
    for model in (plain, rich):
        radiance = model.matte.rows_radiance(rows)
        albedo = log_ratio(radiance.linear, model.light.irradiance(model.matte, rows))
        jumps.append((albedo[lit] - albedo[shaded]).mean(1).numpy())
        # alike in both models: neither chooses the pairs that it is judged by
        alike = of_one_material(parts, albedo, radiance.clipped, config).weight
        weight *= alike * ~(radiance.clipped[shaded] | radiance.clipped[lit]).any(1)
    tables = [table_of(block, jump, weight.sqrt().numpy()) for jump in jumps]
    before, after = (mean_of(table) for table in tables)
    light_error = config.light.shade.light_error
    error = np.hypot(max(mean_error(table) for table in tables), light_error)
    gain = (before**2 - after**2) / error**2
    return float(np.sign(gain) * np.sqrt(abs(gain)))
