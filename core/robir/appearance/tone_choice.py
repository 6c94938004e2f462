# SPDX-License-Identifier: Apache-2.0
"""Which tone curve the photographs went through.

The fit's own loss cannot choose: a compressive curve shrinks every contrast it is judged by. What
can is prediction in display space: take a sample's albedo to a neighbour that receives another
irradiance, and compare the predicted display colour with the photographed one. Only under the true
curve does a shadow darken bright and dark materials by the same factor. Pairs count by how much
their irradiances differ and by how alike their albedos are, on average over all curves: a border
of two materials says nothing, and all curves must be judged by the same pairs.

Between the plain curve and those with a shoulder highlights speak as well, see tone_highlights.py:
where a sun meets one bright material and one dark one, shadows alone may fit either.

One kind of evidence comes before any fit: a curve that clips piles pixels up at code 255, one that
rolls off does not.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch

from robir.appearance.blocks import Table, blocks_of, difference_error, mean_of, table_of
from robir.appearance.config import KNOWN_FAMILIES, AppearanceConfig
from robir.appearance.display_power import PowerChoice, choose_power
from robir.appearance.light import log_ratio
from robir.appearance.problem import Problem, Scene, make_problem
from robir.appearance.solver import ALIKE_BRIGHTNESS, ALIKE_HUE, Light, find_suns, fit
from robir.appearance.tone_highlights import highlight_tables
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

NEUTRAL = "khronos_pbr_neutral"
"""Name of the curve that only the brightest tell from the plain one."""

HEDGE = "robir_aces"
"""Name of a curve that no common renderer has. It lies between the others and is nearest to what
cameras do; where it does not lead all others, one of those is the likelier."""

SIMPLER_MARGIN = 1.0
"""Standard errors within which the simpler one of two curves of a kind is taken."""

PLAIN_MARGIN = 2.0
"""Standard errors by which the plain curve must lead those with a shoulder where nothing is bright.
Photographs that are not rolled off and use the range of the display have clipped highlights, so
where the errors cannot tell, the shoulder is the likelier. On 24 captures, most from two or three
starts, the lead was 1.0 at most under Filmic and 2.8 at least under Standard (docs/tone.md)."""

LEAST_LEAD = 0.1
"""Codes by which mean display errors differ for no reason; adds to their standard error. The
photographs hold whole codes, and where highlights are faint the errors of all curves agree so well
from block to block that a twentieth of a code passed for five standard errors."""


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
        standard_error: Of the difference to the chosen candidate, over blocks of the surface.
        light: The light that was found under it.
        problem: The scene under it.
    """

    curve: AbstractToneCurve
    score: float
    standard_error: float
    light: Light
    problem: Problem


@dataclass(frozen=True, slots=True, kw_only=True)
class PlainLead:
    """How far the plain curve leads the best one with a shoulder, in 8-bit codes.

    Attributes:
        shoulder: Name of that curve.
        carried: By how much its mean display error of cross-predicted pairs is the greater.
        highlights: By how much its mean display error near highlights is; None if none are seen.
        standard_error: Of the sum.
    """

    shoulder: str
    carried: float
    highlights: float | None
    standard_error: float

    @property
    def total(self) -> float:
        """By how much its display errors are the greater."""
        return self.carried + (self.highlights or 0.0)

    @property
    def is_clear(self) -> bool:
        """Whether the photographs were made by the plain curve."""
        return self.total > PLAIN_MARGIN * self.standard_error

    @classmethod
    def of(
        cls, shoulder: str, carried: tuple[Table, Table], highlights: list[Table] | None
    ) -> PlainLead:
        """From tables of both errors, 0..1, of the plain curve and of the other."""
        parts = [carried, *([(highlights[0], highlights[1])] if highlights else [])]
        leads = [255 * (mean_of(other) - mean_of(mine)) for mine, other in parts]
        return cls(
            shoulder=shoulder,
            carried=leads[0],
            highlights=leads[1] if highlights else None,
            standard_error=_error_of_sum(parts),
        )


def _error_of_sum(parts: list[tuple[Table, Table]]) -> float:
    """Standard error, codes, of a sum of differences of mean display errors."""
    errors = [255 * difference_error(mine, other) for mine, other in parts]
    return float(np.sqrt(LEAST_LEAD**2 + np.square(errors).sum()))


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


def pair_likeness(problem: Problem, light: Light) -> torch.Tensor:
    """How alike the albedos of every ordered pair are, 0..1, (2 P,)."""
    scene = problem.scene
    radiance = problem.rows_radiance(scene.rows)
    log_albedo = log_ratio(radiance.linear, light.irradiance(problem, scene.rows))
    alike = scene.pairs.likeness(log_albedo, ALIKE_HUE, ALIKE_BRIGHTNESS)
    return torch.cat([alike, alike])


@dataclass(frozen=True, slots=True, kw_only=True)
class ToneChoice:
    """All that the choice of the tone curve rests on.

    Attributes:
        candidates: The chosen one first, then by score.
        evidence: Of the histogram.
        power: The power of the display codes, None where the curve was given.
        plain_lead: Of the plain curve against those with a shoulder, None where not both were
            compared.
    """

    candidates: list[Candidate]
    evidence: ClippingEvidence
    power: PowerChoice | None
    plain_lead: PlainLead | None


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
    candidates, lead = _ranked(scene, fitting, found, config, seed)
    return ToneChoice(candidates=candidates, evidence=evidence, power=choice, plain_lead=lead)


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
    seed: int,
) -> tuple[list[Candidate], PlainLead | None]:
    """The curves with their scores under the suns found, the chosen one first."""
    models: list[tuple[Problem, Light]] = []
    for curve in curves:
        problem = make_problem(scene, curve)
        light = fit(problem, found.axes, found.sharpness, config.iterations // 2)
        models.append((problem, replace(light, history=found.history)))
    tables = _pair_tables(models)
    names = [curve.name for curve in curves]
    shoulder, chosen, lead = best_shoulder(names, tables), 0, None
    if shoulder is not None:
        chosen = shoulder
        if PLAIN in names:
            plain = names.index(PLAIN)
            highlights = highlight_tables((models[plain], models[shoulder]), seed)
            lead = PlainLead.of(names[shoulder], (tables[plain], tables[shoulder]), highlights)
            chosen = plain if lead.is_clear else shoulder
    if NEUTRAL in names and _lags(tables[chosen], tables[names.index(NEUTRAL)], SIMPLER_MARGIN):
        chosen = names.index(NEUTRAL)
    candidates = [
        Candidate(
            curve=curve,
            score=255 * mean_of(table),
            standard_error=0.0 if index == chosen else _error_of_sum([(table, tables[chosen])]),
            light=light,
            problem=problem,
        )
        for index, (curve, table, (problem, light)) in enumerate(
            zip(curves, tables, models, strict=True)
        )
    ]
    first = candidates.pop(chosen)
    return [first, *sorted(candidates, key=lambda candidate: candidate.score)], lead


def _pair_tables(models: list[tuple[Problem, Light]]) -> list[Table]:
    """Display errors of cross-predicted pairs under each model.

    A pair counts by what the models say of it on average, and so alike in all.
    """
    judged = [pair_errors(*model) for model in models]
    contrast = torch.stack([weight for _, weight in judged]).mean(0)
    likeness = torch.stack([pair_likeness(*model) for model in models]).mean(0)
    weight = (contrast * likeness).double().numpy()
    blocks = blocks_of(models[0][0].scene)
    return [table_of(blocks, error.double().numpy(), weight) for error, _ in judged]


def best_shoulder(names: list[str], tables: list[Table]) -> int | None:
    """Number of the curve with a shoulder that is taken if the plain one is not.

    The simplest within SIMPLER_MARGIN of the lowest error; HEDGE only if it leads all others.
    NEUTRAL is none of them: it would pass for the plain one.

    Args:
        names: Of the curves, simplest first.
        tables: Of their errors.

    Returns:
        Its number; None where there is none.
    """
    shoulders = [i for i, name in enumerate(names) if name not in (PLAIN, NEUTRAL, HEDGE)]
    if HEDGE in names:
        hedge = names.index(HEDGE)
        others = [table for index, table in enumerate(tables) if index != hedge]
        if not shoulders or all(_lags(table, tables[hedge], SIMPLER_MARGIN) for table in others):
            return hedge
    best = min(shoulders, key=lambda index: mean_of(tables[index]), default=0)
    near = [i for i in shoulders if not _lags(tables[i], tables[best], SIMPLER_MARGIN)]
    return min(near, default=None)


def _lags(table: Table, other: Table, margin: float) -> bool:
    """Whether the first error is clearly the greater, by so many standard errors."""
    return 255 * (mean_of(table) - mean_of(other)) > margin * _error_of_sum([(table, other)])
