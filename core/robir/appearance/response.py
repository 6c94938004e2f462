# SPDX-License-Identifier: Apache-2.0
"""Whether photographs by a camera went through another curve than cameras have.

Shadows rank tone curves by how well albedo carries from light into shade (tone/ranking.py), which
errors of the modelled light disturb; from one machine to the next the order of two that are near
each other may turn. Where that asks for another curve than the mean response of cameras, both are
solved to the end, and the other is taken only where the whole model, exposures, light and specular
layer, predicts views by others better than under the response. What photographs that are exposed
apart, or highlights, say of the curve is part of that (Mitsunaga and Nayar 1999, "Radiometric self
calibration", fit a response to exposures alone).
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robir.appearance.config import AppearanceConfig
from robir.appearance.material.trial import Trial
from robir.appearance.proof import Proof
from robir.appearance.solution import Solution, solve
from robir.appearance.tone.choose import ToneChoice
from robir.appearance.tone.ranking import CAMERA
from robir.jobs.choice import Choice
from robir.steps import Course

Reals = NDArray[np.floating[Any]]


def solved(
    tone: ToneChoice, config: AppearanceConfig, seed: int, course: Course
) -> tuple[ToneChoice, Solution]:
    """Light and material under the curve that is taken, which then is the first of the choice.

    Args:
        tone: Curves in the order that shadows give them.
        config: Sizes.
        seed: Of sub-samples and clusters.
        course: Of the stage's steps.
    """
    first, *others = tone.candidates
    solution = solve(first.problem, first.light, config, seed, course)
    camera = next((other for other in others if other.curve.name == CAMERA), None)
    if not tone.scene.by_camera or camera is None:
        return tone, solution
    rival = solve(camera.problem, camera.light, config, seed, course)
    proof = compared(rival, solution)
    leads = lead_in_errors(proof, config.tone.code_error)
    margin = config.response.margin
    is_camera = leads <= margin
    choice = Choice(
        choice="curve of a camera",
        chosen=(camera if is_camera else first).curve.name,
        alternatives=((first if is_camera else camera).curve.name,),
        held_out_error=proof.plain if is_camera else proof.rich,
        why=f"under {first.curve.name}, which shadows ask for, views are predicted from others "
        f"with an error of {proof.rich:.2f} codes, under the response of cameras of "
        f"{proof.plain:.2f}: {leads:+.1f} standard errors; more than {margin:g} are asked for",
    )
    taken = rival if is_camera else solution
    if is_camera:
        rest = [candidate for candidate in tone.candidates if candidate is not camera]
        tone = replace(tone, candidates=[camera, *rest])
    return tone, replace(taken, choices=(*taken.choices, choice))


def compared(plain: Solution, rich: Solution) -> Proof:
    """What views say of two models of one scene, each predicting them from others."""
    scene = plain.problem.scene
    rows = scene.rows[plain.problem.radiance.seen.numpy()[scene.rows]]
    rows = rows[:: -(-len(rows) // plain.config.response.num_samples) or 1]
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
