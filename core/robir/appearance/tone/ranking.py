# SPDX-License-Identifier: Apache-2.0
"""Tone curves ranked by albedo that is carried between neighbours in different light.

The fit's own loss cannot choose: a compressive curve shrinks every contrast it is judged by. What
can is prediction in display space: take a sample's albedo to a neighbour that receives another
irradiance, and compare the predicted display colour with the photographed one. Only under the true
curve does a shadow darken bright and dark materials by the same factor. Pairs count by how much
their irradiances differ and by how alike their albedos are, on average over all curves: a border
of two materials says nothing, and all curves must be judged by the same pairs.

So curves with a shoulder are told from each other. Whether it is the plain one instead, the most
that a choice can cost, is weighed apart, see shoulder.py.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
import torch
from numpy.typing import NDArray

from robir.appearance.blocks import Table, difference_error, mean_of, table_of
from robir.appearance.config import AppearanceConfig
from robir.appearance.light.lobes import log_ratio
from robir.appearance.light.problem import Problem, Scene, blocks_of, make_problem
from robir.appearance.light.shade import ALIKE_BRIGHTNESS, ALIKE_HUE
from robir.appearance.light.solver import Light, fit
from robir.appearance.tone.highlight_evidence import highlight_tables
from robir.appearance.tone.shoulder import CODE_ERROR, PlainLead, mismatch_table
from robir.maths.tone_curve import AbstractToneCurve
from robir.workers import side_by_side

PLAIN = "standard"
"""Name of the plain curve, the sRGB transfer function."""

CAMERA = "camera"
"""Name of the other curve without a shoulder, which cameras have rather than renderers."""

NEUTRAL = "khronos_pbr_neutral"
"""Name of the curve that only the brightest tell from the plain one."""

HEDGE = "robir_aces"
"""Name of a curve that no common renderer has. It lies between the others and is nearest to what
cameras do; where it does not lead all others, one of those is the likelier."""


_MARGINS = {"auto": -1.0, "camera": -2.0, "render": 2.0}
"""Standard errors by which a curve without a shoulder must lead one that has one, by where the
photographs are from: cameras have cameras' responses, renderers mostly a shoulder. Who tells
nothing mostly brings photographs."""

_ERROR_CAP = 0.08  # display error, 0..1, beyond which a pair is of two materials and says no more
_LEAST_CONTRAST = 0.3  # difference of log irradiance from which a pair counts, by what exceeds it
_MOST_CONTRAST = 1.5  # difference from which it counts no more than others
# standard errors within which the simpler one of two curves of a kind is taken
SIMPLER_MARGIN = 1.0
# standard errors by which `NEUTRAL` must lead: few use it, and few pixels tell it
_NEUTRAL_MARGIN = 3.5
# lead of the plain curve over a shoulder below which their lights need not be settled: that moves
# it by less (standard errors)
_SETTLED_BELOW = -1.0


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


def _lead_error(mine: Table, other: Table, code_error: float) -> float:
    """Standard error, codes, of the difference of two mean display errors."""
    return float(np.hypot(code_error, 255 * difference_error(mine, other)))


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
    contrast = contrast.clamp(max=_MOST_CONTRAST)
    weight = (contrast - _LEAST_CONTRAST).clamp(min=0)
    return error.clamp(max=_ERROR_CAP).mean(1), weight


def pair_likeness(problem: Problem, light: Light) -> torch.Tensor:
    """How alike the albedos of every ordered pair are, 0..1, (2 P,)."""
    scene = problem.scene
    radiance = problem.rows_radiance(scene.rows)
    log_albedo = log_ratio(radiance.linear, light.irradiance(problem, scene.rows))
    alike = scene.pairs.likeness(log_albedo, ALIKE_HUE, ALIKE_BRIGHTNESS)
    return torch.cat([alike, alike])


@dataclass(frozen=True, slots=True, kw_only=True)
class Judged:
    """Models of one scene under several curves, judged by the same pairs.

    Attributes:
        models: The scene under each curve, and its light.
        blocks: (2 P,) of every ordered pair.
        weight: (2 P,) by which pairs count: what the models say on average.
        tables: Display errors of the pairs under each curve.
        config: Of the choice.
        settled: The models, by number, whose lights were settled so far.
    """

    models: list[tuple[Problem, Light]]
    blocks: NDArray[np.int64]
    weight: NDArray[np.float64]
    tables: list[Table]
    config: AppearanceConfig
    settled: dict[int, tuple[Problem, Light]] = field(default_factory=dict)

    @classmethod
    def of(cls, models: list[tuple[Problem, Light]], config: AppearanceConfig) -> Judged:
        """From the models alone."""
        judged = side_by_side(lambda model: pair_errors(*model), models)
        contrast = torch.stack([weight for _, weight in judged]).mean(0)
        likeness = torch.stack(side_by_side(lambda model: pair_likeness(*model), models)).mean(0)
        weight = (contrast * likeness).double().numpy()
        blocks = blocks_of(models[0][0].scene)
        tables = [table_of(blocks, error.double().numpy(), weight) for error, _ in judged]
        return cls(models=models, blocks=blocks, weight=weight, tables=tables, config=config)

    def lead(self, index: int, shoulder: int, steps: int, seed: int) -> PlainLead:
        """How far one curve leads another that has a shoulder.

        Where that is close, their lights are settled first: a curve of more contrast starts farther
        from its light, and after the steps that rank all curves it has up to a quarter of its
        mismatch still to lose.

        Args:
            index: Number of the one.
            shoulder: Number of the other.
            steps: Further steps that settle their lights.
            seed: Of what is looked at.
        """
        lead, unsettled = self._compared(index, shoulder, seed), {index, shoulder} - {*self.settled}
        if lead.total < _SETTLED_BELOW or not unsettled:
            return lead

        def settled(number: int) -> tuple[Problem, Light]:
            problem, light = self.models[number]
            further = fit(problem, light.axes, light.sharpness, steps, start=light.amplitudes)
            return problem, further

        numbers = sorted(unsettled)
        self.settled.update(zip(numbers, side_by_side(settled, numbers), strict=True))
        return self._compared(index, shoulder, seed)

    def _compared(self, index: int, shoulder: int, seed: int) -> PlainLead:
        """The same with the lights as they are."""
        two = tuple(self.settled.get(n, self.models[n]) for n in (index, shoulder))
        mine, other = side_by_side(
            lambda model: mismatch_table(*model, self.blocks, self.weight), two
        )
        highlights = highlight_tables((two[0], two[1]), seed)
        names = (two[0][0].curve.name, two[1][0].curve.name)
        lead = PlainLead.of(names, (mine, other), highlights)
        return replace(lead, margin=_MARGINS[self.config.origin])


def ranked(
    scene: Scene,
    curves: list[AbstractToneCurve],
    found: Light,
    config: AppearanceConfig,
    seed: int,
) -> tuple[list[Candidate], PlainLead | None]:
    """The curves with their scores under the suns found, the chosen one first."""

    def solved(curve: AbstractToneCurve) -> tuple[Problem, Light]:
        problem = make_problem(scene, curve)
        light = fit(problem, found.axes, found.sharpness, config.iterations // 2)
        return problem, replace(light, history=found.history)

    models = side_by_side(solved, curves)
    judged = Judged.of(models, config)
    chosen, lead = chosen_number(judged, [curve.name for curve in curves], config.iterations, seed)
    tables = judged.tables
    candidates = [
        Candidate(
            curve=curve,
            score=255 * mean_of(table),
            standard_error=0.0
            if index == chosen
            else _lead_error(table, tables[chosen], CODE_ERROR),
            light=light,
            problem=problem,
        )
        for index, (curve, table, (problem, light)) in enumerate(
            zip(curves, tables, models, strict=True)
        )
    ]
    first = candidates.pop(chosen)
    return [first, *sorted(candidates, key=lambda candidate: candidate.score)], lead


def chosen_number(
    judged: Judged, names: list[str], steps: int, seed: int
) -> tuple[int, PlainLead | None]:
    """Number of the curve to be taken, and the plain one's lead if it was compared.

    Args:
        judged: The scene under each curve.
        names: Of the curves, simplest first.
        steps: Further steps that settle the lights of two that are compared closely.
        seed: Of what is looked at.
    """
    tables = judged.tables
    shoulder, plain, lead = best_shoulder(names, tables), None, None
    if PLAIN in names or CAMERA in names:
        plain = _plain_number(judged, names, steps, seed)
    chosen = next((number for number in (shoulder, plain) if number is not None), 0)
    if shoulder is not None and plain is not None:
        lead = judged.lead(plain, shoulder, steps, seed)
        chosen = plain if lead.is_clear else shoulder
    if NEUTRAL in names:
        neutral = names.index(NEUTRAL)
        leads = _lags(tables[chosen], tables[neutral], _NEUTRAL_MARGIN)
        # but for the brightest it is the plain one, and must lead a shoulder as that must
        if leads and (chosen != shoulder or judged.lead(neutral, chosen, steps, seed).is_clear):
            chosen = neutral
    return chosen, lead


def _plain_number(judged: Judged, names: list[str], steps: int, seed: int) -> int:
    """Number of the likelier of the curves without a shoulder.

    The response of a camera must lead the sRGB transfer function as that a shoulder.
    """
    if CAMERA not in names:
        return names.index(PLAIN)
    camera = names.index(CAMERA)
    if PLAIN not in names:
        return camera
    plain = names.index(PLAIN)
    return camera if judged.lead(camera, plain, steps, seed).is_clear else plain


def best_shoulder(names: list[str], tables: list[Table]) -> int | None:
    """Number of the curve with a shoulder that is taken if the plain one is not.

    The simplest within `SIMPLER_MARGIN` of the lowest error; HEDGE only if it leads all others.
    NEUTRAL is none of them: it would pass for the plain one.

    Args:
        names: Of the curves, simplest first.
        tables: Of their errors.

    Returns:
        Its number; None where there is none.
    """
    apart = (PLAIN, CAMERA, NEUTRAL, HEDGE)
    shoulders = [i for i, name in enumerate(names) if name not in apart]
    if HEDGE in names:
        hedge = names.index(HEDGE)
        others = [table for index, table in enumerate(tables) if index != hedge]
        if not shoulders or all(_lags(table, tables[hedge]) for table in others):
            return hedge
    best = min(shoulders, key=lambda index: mean_of(tables[index]), default=0)
    near = [i for i in shoulders if not _lags(tables[i], tables[best])]
    return min(near, default=None)


def _lags(table: Table, other: Table, margin: float = SIMPLER_MARGIN) -> bool:
    """Whether the first error is the greater by so many standard errors."""
    lead = 255 * (mean_of(table) - mean_of(other))
    return lead > margin * _lead_error(table, other, CODE_ERROR)
