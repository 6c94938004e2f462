# SPDX-License-Identifier: Apache-2.0
"""How much of the light model a scene needs beside its suns.

Under an overcast sky the lobes that stand for the sky have nothing to tell apart, and one number a
channel does for all of them. They are replaced by an even sky where that predicts the photographs
within one standard error as well. Beside a sun they are kept: they also take up what the mesh's
errors do to its light.

Light that the object throws on itself is measured by the photographs and has no unknowns, so no
error can be lowered by leaving it out; it is left out where there is none.
"""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray

from robir.appearance.blocks import Table, difference_error, mean_of, table_of
from robir.appearance.config import AppearanceConfig
from robir.appearance.light.problem import Problem, blocks_of
from robir.appearance.light.solver import Light, fit
from robir.appearance.tone.ranking import pair_errors
from robir.jobs.choice import Choice


def with_even_sky(
    problem: Problem, light: Light, config: AppearanceConfig
) -> tuple[Problem, Light, Choice]:
    """One even sky for all soft lobes if the scene has no sun and shows no difference.

    Returns:
        The problem, the light under it, and why.
    """
    num_soft = len(light.amplitudes.soft)
    many, one = f"{num_soft} lobes", "even: one lobe"
    if len(light.axes):
        why = "beside a sun the lobes also take up what errors of the mesh do to its light"
        return problem, light, Choice(choice="sky", chosen=many, alternatives=(one,), why=why)
    started = time.process_time()
    # fits cut short differ by more than the models do: after half the steps the lobes of a flat sky
    # led it by .2 codes or by none, after the rounding of one machine or of another
    even, steps = problem.with_lobes(1), 2 * config.iterations
    simple, rich = _held_out_tables((even, problem), light, steps)
    more, error = mean_of(simple) - mean_of(rich), difference_error(simple, rich)
    is_even = more <= error
    choice = Choice(
        choice="sky",
        chosen=one if is_even else many,
        alternatives=(many if is_even else one,),
        held_out_error=255 * mean_of(simple if is_even else rich),
        cost_seconds=time.process_time() - started,
        why="display error of albedo carried between neighbours of the half that was not fitted is "
        f"{255 * more:+.2f} codes with an even sky, standard error {255 * error:.2f}; the simplest "
        "within one standard error",
    )
    if is_even:
        fitted = fit(even, light.axes, light.sharpness, steps)
        return even, replace(fitted, history=light.history), choice
    return problem, light, choice


def _held_out_tables(
    models: tuple[Problem, Problem], light: Light, steps: int
) -> tuple[Table, Table]:
    """Display errors of pairs under lights fitted to the other half of the surface, by block.

    Pairs count by how much the light differs between them; what the first model says of it holds
    for both, or they would be judged by different pairs.
    """
    scene = models[0].scene
    count, blocks = len(scene.pairs.first), blocks_of(scene)
    # halves of the blocks; pairs from one half to the other belong to neither
    first, second = np.split(np.random.default_rng(0).integers(0, 2, blocks.max() + 1)[blocks], 2)
    values, weights = np.zeros((2, 2 * count)), np.zeros(2 * count)
    for half in (0, 1):
        inside, outside = (np.flatnonzero((first == k) & (second == k)) for k in (half, 1 - half))
        both_ways = np.concatenate([inside, inside + count])
        for index, model in enumerate(models):
            trained = fit(_on_pairs(model, outside), light.axes, light.sharpness, steps)
            error, weight = pair_errors(_on_pairs(model, inside), trained)
            values[index, both_ways] = error.numpy()
            if index == 0:
                weights[both_ways] = weight.numpy()
    simple, rich = (table_of(blocks, value, weights) for value in values)
    return simple, rich


def _on_pairs(problem: Problem, chosen: NDArray[np.int64]) -> Problem:
    """The problem with some of its pairs."""
    part = problem.scene.pairs.of(torch.from_numpy(chosen))
    return replace(problem, scene=replace(problem.scene, pairs=part))
