# SPDX-License-Identifier: Apache-2.0
"""Light and material of a scene under its tone curve, step by step.

Light first, then the specular layer, then the light's strengths once more without the highlights.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from robir.appearance.config import AppearanceConfig
from robir.appearance.evidence import (
    BY_KNOWN_ALBEDO,
    Estimate,
    level_estimates,
    sent_by_known_albedo,
)
from robir.appearance.light.distance import with_distance
from robir.appearance.light.known_albedo import READ_ERROR
from robir.appearance.light.lobes import NO_PRIOR, LightPrior
from robir.appearance.light.problem import Problem
from robir.appearance.light.solver import Light, refit
from robir.appearance.light.sun_search import polish
from robir.appearance.material.metal import SOLVED_WITHOUT
from robir.appearance.material.specular import SpecularMaterial, estimate_specular
from robir.jobs.context import Choice
from robir.steps import Pipeline, Step

# how much more firmly a told level is held than its error asks. In a solve pairs of neighbours
# speak of it as well, by the light between surfaces, and errors of the mesh are common to many.
_FIRMNESS = 3.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Solution:
    """What is known of light and material."""

    problem: Problem  # the scene under the chosen tone curve, highlights and all
    matte: Problem  # the same without the highlights that are known
    light: Light  # the light so far
    config: AppearanceConfig  # sizes
    seed: int  # of sub-samples and clusters
    # specular material so far; None before it was estimated
    specular: SpecularMaterial | None = None
    # level and hue of the light as a whole, as far as evidence gives them
    prior: LightPrior = NO_PRIOR
    # what was chosen, for the report
    choices: tuple[Choice, ...] = field(default=(), compare=False)
    # what evidence says of the light, for the report
    estimates: tuple[Estimate, ...] = field(default=(), compare=False)

    @property
    def material(self) -> SpecularMaterial:
        """Specular material, once it was looked for."""
        if self.specular is None:
            raise RuntimeError("gloss was not looked for")
        return self.specular


def solve(
    problem: Problem, light: Light, config: AppearanceConfig, seed: int, pipeline: Pipeline
) -> Solution:
    """Light and material, all steps run, from a first light under the chosen tone curve."""
    start = Solution(problem=problem, matte=problem, light=light, config=config, seed=seed)
    return pipeline.run(SOLUTION, start)


def _polish(state: Solution) -> Solution:
    return replace(state, light=polish(state.problem, state.light, state.config, state.seed))


def _find_distance(state: Solution) -> Solution:
    problem, light, afar = with_distance(state.problem, state.light, state.config, state.seed)
    if problem is state.problem:
        return replace(state, light=light)
    choice = Choice(
        choice="distance of the light",
        chosen=f"{problem.scene.light_distance:g} radii of the thing",
        alternatives=("far, as a sky is",),
        held_out_error=light.loss,
        why=f"from afar neighbours' albedo differs by {afar:.3f}; the environment that is "
        "exported is the one that the middle of the thing sees",
    )
    choices = (*state.choices, choice)
    return replace(state, problem=problem, matte=problem, light=light, choices=choices)


def _by_every_sample(state: Solution) -> Solution:
    whole = state.problem.by_every_sample(np.random.default_rng(state.seed))
    return replace(state, problem=whole, matte=whole)


def _find_specular(state: Solution) -> Solution:
    specular, diffuse = estimate_specular(
        state.problem, state.light, state.config.num_materials, state.seed
    )
    matte, rows = state.problem.without_highlights(diffuse), state.problem.scene.rows
    # metal has no diffuse light, so that its brightness tells nothing of what it receives
    dielectric = specular.solved_by(rows, SOLVED_WITHOUT)
    if len(dielectric) < len(rows):
        matte = matte.by_samples(dielectric, np.random.default_rng(state.seed))
    return replace(state, specular=specular, matte=matte)


def _level(state: Solution) -> Solution:
    solved = state.matte.scene.rows
    estimates = level_estimates(state.problem, state.light, state.material, solved)
    if not estimates:
        return state
    *_, together = estimates
    error = together.deviation / _FIRMNESS
    prior = replace(state.prior, level=together.value, level_error=error)
    return replace(state, prior=prior, estimates=(*state.estimates, *estimates))


def _white_point(state: Solution) -> Solution:
    known = state.problem.scene.known_albedo
    if known is None:
        return state
    sent = sent_by_known_albedo(state.matte, state.light, known)
    level = float(sent.mean())
    prior = LightPrior(hue=sent - level, hue_error=READ_ERROR, level=level, level_error=READ_ERROR)
    hue = float(sent[0] - sent[2])
    rows = (
        Estimate(of="level", by=BY_KNOWN_ALBEDO, value=level, deviation=READ_ERROR),
        Estimate(of="hue", by=BY_KNOWN_ALBEDO, value=hue, deviation=READ_ERROR * 2**0.5),
    )
    return replace(state, prior=prior, estimates=(*state.estimates, *rows))


def _refit(state: Solution) -> Solution:
    # twice the steps: a sky that only few samples face takes its time
    thorough = replace(state.config, iterations=2 * state.config.iterations)
    return replace(state, light=refit(state.matte, state.light, state.prior, thorough))


# all steps, in their order
SOLUTION: tuple[Step[Solution], ...] = (
    Step(
        name="polish",
        purpose="moves and sizes the suns with the whole light known",
        source="ours",
        run=_polish,
    ),
    Step(
        name="distance",
        purpose="solves the light's strengths, and tells a room's light, which is near, from a "
        "sky's",
        source="ours: robust differences of log albedo (Land and McCann's Retinex), light from a "
        "sphere, inverse square law",
        run=_find_distance,
    ),
    Step(
        name="every-sample",
        purpose="goes on with all samples: the suns were found by some",
        source="ours",
        run=_by_every_sample,
        is_on_trial=False,
    ),
    Step(
        name="gloss",
        purpose="finds highlights and metal",
        source="GGX microfacets (Heitz 2014), a roughness a patch",
        run=_find_specular,
        is_on_trial=False,
    ),
    Step(
        name="level",
        purpose="takes the light's level from common paints and exposures",
        source="ours: Bayes' rule",
        run=_level,
    ),
    Step(
        name="white-point",
        purpose="takes level and hue from paint that the user knows, where one is told",
        source="calibration by a known patch, as of a colour checker",
        run=_white_point,
        is_on_trial=False,
    ),
    Step(
        name="refit",
        purpose="solves the strengths by all samples, without the highlights, at the level and hue "
        "told",
        source="ours",
        run=_refit,
    ),
)
