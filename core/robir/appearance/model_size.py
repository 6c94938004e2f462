# SPDX-License-Identifier: Apache-2.0
"""How much of the light model a scene needs beside its suns.

Under an overcast sky the lobes that stand for the sky have nothing to tell apart, and one number a
channel does for all of them. They are replaced by an even sky where that predicts the photographs
within one standard error as well. Beside a sun they are kept: they also take up what the mesh's
errors do to its light.

Light that the object throws on itself is measured by the photographs and has no unknowns, so no
error can be lowered by leaving it out; it is left out where there is none.

The sky that paint reflects has more freedom than shading tells it, and is taken only on proof.
"""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray

from robir.appearance.blocks import Table, block_numbers, difference_error, mean_of, table_of
from robir.appearance.config import AppearanceConfig
from robir.appearance.evidence.reflected_sky import ReflectedSkies, ReflectedSky, skies_by_paint
from robir.appearance.light.lobes import log_ratio
from robir.appearance.light.problem import Problem, blocks_of
from robir.appearance.light.solver import Light, fit
from robir.appearance.material.gloss import Gloss
from robir.appearance.proof import Proof
from robir.appearance.tone.ranking import pair_errors
from robir.jobs.choice import Choice

SHADED, REFLECTED = "as shading has it", "as paint reflects it"


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


def with_reflected_sky(
    problem: Problem, light: Light, gloss: Gloss, config: AppearanceConfig
) -> tuple[Problem, Light, float | None, Choice] | None:
    """The sky as paint reflects it, where views prove it.

    What reaches the diffuse surface changes by little, or by more where that makes albedos more
    alike: views alone would take any freedom that they are given.

    Args:
        problem: Scene under a tone curve, highlights included.
        light: Solved light.
        gloss: Specular material under it.
        config: Sizes, and what is tried.

    Returns:
        The problem, the light under it, the roughness of all paint if that is told, and why; None
        where too little paint is seen.
    """
    started = time.process_time()
    told = skies_by_paint(problem, light, gloss, config.num_soft_lobes, config.evidence)
    if told is None:
        return None
    chosen, *freer = told.skies
    is_taken = Proof.of(told.before, chosen.errors, told.groups).is_given
    for sky in freer:
        proof = Proof.of(chosen.errors if is_taken else told.before, sky.errors, told.groups)
        if proof.is_given and _is_evener(told, chosen, sky, config):
            chosen, is_taken = sky, True
    proof = Proof.of(told.before, chosen.errors, told.groups)
    choice = Choice(
        choice="sky in paint",
        chosen=REFLECTED if is_taken else SHADED,
        alternatives=(SHADED if is_taken else REFLECTED,),
        held_out_error=proof.rich if is_taken else proof.plain,
        cost_seconds=time.process_time() - started,
        why=f"with the sky as paint reflects it {proof.words}",
    )
    if not is_taken:
        return problem, light, None, choice
    return told.problem, chosen.light, chosen.roughness, choice


def _is_evener(
    told: ReflectedSkies, plain: ReflectedSky, rich: ReflectedSky, config: AppearanceConfig
) -> bool:
    """Whether what is of one hue, wherever it lies, differs less in albedo under the second sky.

    Neighbours alone would not tell: the shading of a lone thing varies slowly.
    """
    rng, asked = np.random.default_rng(0), config.model_size
    count = len(told.rows)
    first = np.repeat(np.arange(count), asked.num_partners)
    second = rng.integers(0, count, len(first))
    albedos = [
        log_ratio(sky.diffuse, sky.light.irradiance(told.problem, told.rows)).double().numpy()
        for sky in (plain, rich)
    ]
    bright = [albedo.mean(1) for albedo in albedos]
    hues = [albedo - value[:, None] for albedo, value in zip(albedos, bright, strict=True)]
    apart = np.mean([np.abs(hue[first] - hue[second]).sum(1) for hue in hues], axis=0)
    weight = np.exp(-0.5 * (apart / config.light.shade.alike_hue) ** 2)
    position = told.problem.scene.transport.surfels.position[told.rows]
    block = block_numbers(position, config.blocks)[first]
    simple, other = (
        table_of(block, np.abs(value[first] - value[second]).clip(max=asked.other_paint), weight)
        for value in bright
    )
    return mean_of(simple) - mean_of(other) > difference_error(simple, other)
