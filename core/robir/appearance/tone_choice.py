# SPDX-License-Identifier: Apache-2.0
"""Which tone curve the photographs went through.

The fit's own loss cannot choose: a compressive curve shrinks every contrast it is judged by. What
can is prediction in display space: take a sample's albedo to a neighbour that receives another
irradiance, and compare the predicted display colour with the photographed one. Only under the true
curve does a shadow darken bright and dark materials by the same factor. Pairs count by how much
their irradiances differ.

One kind of evidence comes before any fit: a curve that clips piles pixels up at code 255, one that
rolls off does not.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch

from robir.appearance.blocks import blocks_of, difference_error, mean_of, table_of
from robir.appearance.config import KNOWN_FAMILIES, AppearanceConfig
from robir.appearance.display_power import PowerChoice, choose_power
from robir.appearance.light import log_ratio
from robir.appearance.problem import Problem, Scene, make_problem
from robir.appearance.solver import Light, find_suns, fit
from robir.maths.tone import curve_from_name, powered
from robir.maths.tone_curve import AbstractToneCurve
from robir.transport.observe import Observations

ERROR_CAP = 0.08
"""Display error beyond which a pair is of two materials and says nothing more."""

CLIPPED_SHARE = 0.004
"""Share of observations at code 255 from which clipping is plain."""

SPIKE_RATIO = 1.5
"""How many times the pixels at 255 must outnumber those at 245 to 254 for a spike."""

FEW_CLIPPED = 3e-4
"""Share of observations at code 255 that is no glint any more, if next to none lie just below."""

LONE_RATIO = 10.0
"""How many times those must outnumber the pixels just below."""

PLAIN = "standard"
"""Name of the one curve without a shoulder."""

HEDGE = "robir_aces"
"""Name of a curve that no common renderer or camera has. It lies between the others, so where they
cannot be told apart it errs least under all of them."""

HEDGE_MARGIN = 3.0
"""Standard errors by which it must lead to be taken for more than that."""

PLAIN_MARGIN = 3.0
"""The same for the plain curve against those with a shoulder, where nothing is bright."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ClippingEvidence:
    """What the histogram says about white.

    Attributes:
        clipped_share: Observations with a channel at code 255.
        bright_share: Observations with their brightest channel at 245 to 254.
    """

    clipped_share: float
    bright_share: float

    @property
    def verdict(self) -> bool | None:
        """True for a clipping curve, False for one that rolls off, None if nothing is bright."""
        if self.clipped_share > CLIPPED_SHARE:
            return self.clipped_share > SPIKE_RATIO * self.bright_share / 2
        if self.bright_share > 4 * CLIPPED_SHARE:
            return False
        if self.clipped_share > max(FEW_CLIPPED, LONE_RATIO * self.bright_share):
            return True
        return None


@dataclass(frozen=True, slots=True, kw_only=True)
class Candidate:
    """A tone curve with its score.

    Attributes:
        curve: The tone curve.
        score: Mean display error of cross-predicted pairs, in 8-bit codes.
        standard_error: Of the difference to the best candidate, over blocks of the surface.
        light: The light that was found under it.
        problem: The scene under it.
    """

    curve: AbstractToneCurve
    score: float
    standard_error: float
    light: Light
    problem: Problem


def clipping_evidence(observations: Observations, power: float = 1.0) -> ClippingEvidence:
    """Shares of clipped and of nearly white observations, a power of the codes undone."""
    valid = observations.weight > 0
    brightest = 255 * (observations.display.max(2) / 255) ** (1 / power)
    clipped = observations.clipped.any(2)
    total = max(1, int(valid.sum()))
    return ClippingEvidence(
        clipped_share=float((clipped & valid).sum() / total),
        bright_share=float(((brightest >= 245) & ~clipped & valid).sum() / total),
    )


def pair_errors(problem: Problem, light: Light) -> tuple[torch.Tensor, torch.Tensor]:
    """Display error and weight of every ordered pair, (2 P,) each."""
    scene = problem.scene
    irradiance = light.irradiance(problem, scene.rows)
    radiance = problem.rows_radiance(scene.rows)
    albedo = log_ratio(radiance.linear, irradiance).exp()
    first = torch.cat([scene.pairs.first, scene.pairs.second])
    second = torch.cat([scene.pairs.second, scene.pairs.first])
    shown = problem.curve.display_from_linear(albedo * irradiance / np.pi)
    carried = problem.curve.display_from_linear(albedo[second] * irradiance[first] / np.pi)
    error = (carried - shown[first]).abs()
    error = error.masked_fill(radiance.clipped[first] | radiance.clipped[second], 0)
    contrast = (irradiance[first].log() - irradiance[second].log()).abs().mean(1)
    weight = (contrast.clamp(max=1.5) - 0.3).clamp(min=0)
    return error.clamp(max=ERROR_CAP).mean(1), weight


@dataclass(frozen=True, slots=True, kw_only=True)
class ToneChoice:
    """All that the choice of the tone curve rests on.

    Attributes:
        candidates: The chosen one first, then by score.
        evidence: Of the histogram.
        power: The power of the display codes, None where the curve was given.
    """

    candidates: list[Candidate]
    evidence: ClippingEvidence
    power: PowerChoice | None


def choose_tone_curve(scene: Scene, config: AppearanceConfig, seed: int) -> ToneChoice:
    """Score every family that the histogram allows, as the photographs are and re-toned.

    The suns are searched once, under the first curve: where shadows lie does not depend on it. It
    also serves to ask for a power of the codes. A curve given by the user is taken as given.

    Args:
        scene: Samples with their transport.
        config: Families and sizes.
        seed: Of the search.

    Returns:
        Candidates and evidence.
    """
    allowed = [curve_from_name(name) for name in KNOWN_FAMILIES if name in config.families]
    evidence = clipping_evidence(scene.transport.observations)
    fitting = _fitting(allowed, evidence)
    # Filmic lies between the families, so its suns start all of them.
    first = next((curve for curve in fitting if curve.name == "filmic"), fitting[0])
    found = find_suns(make_problem(scene, first), config, seed)
    choice = None if len(allowed) == 1 else choose_power(scene, first, found, seed)
    if choice is not None and choice.power != 1.0:
        evidence = clipping_evidence(scene.transport.observations, choice.power)
        fitting = [powered(curve, choice.power) for curve in _fitting(allowed, evidence)]
    candidates = _ranked(scene, fitting, found, config, evidence)
    return ToneChoice(candidates=candidates, evidence=evidence, power=choice)


def _fitting(
    allowed: list[AbstractToneCurve], evidence: ClippingEvidence
) -> list[AbstractToneCurve]:
    """The curves that the histogram does not rule out; all if it would rule out every one."""
    verdict = evidence.verdict
    return [
        curve for curve in allowed if verdict is None or (curve.name == PLAIN) == verdict
    ] or allowed


def _ranked(
    scene: Scene,
    curves: list[AbstractToneCurve],
    found: Light,
    config: AppearanceConfig,
    evidence: ClippingEvidence,
) -> list[Candidate]:
    """The curves with their scores under the suns found, preferred order."""
    blocks = blocks_of(scene)
    fits, tables = [], []
    for curve in curves:
        problem = make_problem(scene, curve)
        light = fit(problem, found.axes, found.sharpness, config.iterations // 2)
        fits.append((curve, light, problem))
        error, weight = pair_errors(problem, light)
        tables.append(table_of(blocks, error.double().numpy(), weight.double().numpy()))
    scores = [255 * mean_of(table) for table in tables]
    best = int(np.argmin(scores))
    candidates = [
        Candidate(
            curve=curve,
            score=scores[index],
            standard_error=255 * difference_error(tables[index], tables[best]),
            light=replace(light, history=found.history),
            problem=problem,
        )
        for index, (curve, light, problem) in enumerate(fits)
    ]
    return preferred_order(candidates, evidence.verdict)


def preferred_order(candidates: list[Candidate], verdict: bool | None) -> list[Candidate]:
    """By score, but the simplest within one standard error of the best comes first.

    The rule does not cross between the plain sRGB curve and those with a shoulder: taking one for
    the other costs far more than any simplicity is worth. Where the scores cannot tell those two
    kinds apart and nothing is bright, the shoulder is the likelier: photographs that are not rolled
    off and use the range of the display have clipped highlights.
    """
    ranked = sorted(candidates, key=lambda candidate: candidate.score)
    if ranked[0].curve.name == HEDGE and len(ranked) > 1:
        second = ranked[1]
        if second.score - ranked[0].score <= HEDGE_MARGIN * second.standard_error:
            ranked.append(ranked.pop(0))
    best = ranked[0]
    shoulders = [candidate for candidate in ranked if candidate.curve.name != PLAIN]
    if best.curve.name == PLAIN and verdict is None and shoulders:
        lead = shoulders[0].score - best.score
        best = shoulders[0] if lead <= PLAIN_MARGIN * shoulders[0].standard_error else best
    for candidate in candidates:
        if candidate.curve.name == HEDGE:
            continue
        alike = (candidate.curve.name == PLAIN) == (best.curve.name == PLAIN)
        if alike and candidate.score - best.score <= candidate.standard_error:
            ranked.remove(candidate)
            return [candidate, *ranked]
    return ranked
