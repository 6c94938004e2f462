# SPDX-License-Identifier: Apache-2.0
"""Tone curves ranked by albedo that is carried between neighbours in different light.

The fit's own loss cannot choose, as a compressive curve shrinks every contrast. So a sample's
albedo is taken to a neighbour of another irradiance, and its display colour is predicted: only
under the true curve does a shadow darken bright and dark materials by one factor. Pairs count by
how much their irradiances differ and how alike their albedos are, on average over all curves.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from robir.appearance.config import AppearanceConfig
from robir.appearance.held_out_test import Table, difference_error, mean_of, table_of
from robir.appearance.light.lobes import log_ratio
from robir.appearance.light.problem import Problem, Scene, blocks_of, make_problem
from robir.appearance.light.solver import Light, fit
from robir.appearance.light.sunlight import ALIKE_BRIGHTNESS, ALIKE_HUE
from robir.maths.tone_curve import AbstractToneCurve
from robir.workers import side_by_side

PLAIN = "standard"  # name of the plain curve, the sRGB transfer function

CAMERA = "camera"  # name of the mean response of cameras

# Standard errors by which the response of cameras must lag the best curve before that is taken, by
# where the photographs are from. Errors of the light bend shades as curves do: it lagged by up to
# 2.4 on nine drawn captures of photographs, by 3.1 to 5.5 on seven of eleven renderings. On the
# other four its albedo is better by up to 3 dB, or worse by 1.
_CAMERA_LAG = {"auto": 2.5, "camera": np.inf, "render": -np.inf}

_ERROR_CAP = 0.08  # display error, 0..1, beyond which a pair is of two materials and says no more
_LEAST_CONTRAST = 0.3  # difference of log irradiance from which a pair counts, by what exceeds it
_MOST_CONTRAST = 1.5  # difference from which it counts no more than others
# standard errors within which the simpler one of two curves is taken
SIMPLER_MARGIN = 1.0
# display codes by which mean errors differ for no reason; adds to their standard error, as
# photographs hold whole codes
CODE_ERROR = 0.1


@dataclass(frozen=True, slots=True, kw_only=True)
class CurveCandidate:
    """A tone curve with its score."""

    curve: AbstractToneCurve  # the tone curve
    score: float  # mean display error of cross-predicted pairs, in 8-bit codes
    standard_error: float  # of the difference to the chosen candidate, over blocks of the surface
    light: Light  # the light that was found under it
    problem: Problem  # the scene under it


def pair_errors(problem: Problem, light: Light) -> tuple[Tensor, Tensor]:
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


def pair_likeness(problem: Problem, light: Light) -> Tensor:
    """How alike the albedos of every ordered pair are, 0..1, (2 P,)."""
    scene = problem.scene
    radiance = problem.rows_radiance(scene.rows)
    log_albedo = log_ratio(radiance.linear, light.irradiance(problem, scene.rows))
    alike = scene.pairs.likeness(log_albedo, ALIKE_HUE, ALIKE_BRIGHTNESS)
    return torch.cat([alike, alike])


def error_tables(models: list[tuple[Problem, Light]]) -> list[Table]:
    """Display errors, 0..1, of carried albedo by blocks of the surface, a model each."""
    scored = side_by_side(lambda model: pair_errors(*model), models)
    contrast = torch.stack([weight for _, weight in scored]).mean(0)
    likeness = torch.stack(side_by_side(lambda model: pair_likeness(*model), models)).mean(0)
    weight = (contrast * likeness).double().numpy()
    blocks: NDArray[np.int64] = blocks_of(models[0][0].scene)
    return [table_of(blocks, error.double().numpy(), weight) for error, _ in scored]


def ranked(
    scene: Scene, curves: list[AbstractToneCurve], found: Light, config: AppearanceConfig
) -> list[CurveCandidate]:
    """The curves with their scores under the suns found, the chosen one first."""

    def solved(curve: AbstractToneCurve) -> tuple[Problem, Light]:
        problem = make_problem(scene, curve)
        light = fit(problem, found.axes, found.sharpness, config.iterations // 2)
        return problem, replace(light, history=found.history)

    models = side_by_side(solved, curves)
    names, tables = [curve.name for curve in curves], error_tables(models)
    if CAMERA in names and _camera_holds(models, tables, names, config):
        chosen = names.index(CAMERA)
    else:
        chosen = simplest_near_best(tables, names)
    candidates = [
        CurveCandidate(
            curve=curve,
            score=255 * mean_of(table),
            standard_error=0.0 if index == chosen else _lag(table, tables[chosen])[1],
            light=light,
            problem=problem,
        )
        for index, (curve, table, (problem, light)) in enumerate(
            zip(curves, tables, models, strict=True)
        )
    ]
    first = candidates.pop(chosen)
    return [first, *sorted(candidates, key=lambda candidate: candidate.score)]


def simplest_near_best(tables: list[Table], names: list[str]) -> int:
    """Number of the simplest curve within `SIMPLER_MARGIN` of the lowest error.

    `names` are simplest first. A camera's response is none of them, where there are others; the
    plain curve comes last, as most renderers roll off.
    """
    best = _best(tables, names)
    order = sorted(range(len(names)), key=lambda number: names[number] == PLAIN)
    near = (n for n in order if names[n] != CAMERA and not _lags(tables, n, best))
    return next(near, best)


def camera_lags(tables: list[Table], names: list[str], origin: str) -> bool:
    """Whether a camera's response lags the best of the others by more than `origin` allows."""
    camera, best = names.index(CAMERA), _best(tables, names)
    return camera != best and _lags(tables, camera, best, _CAMERA_LAG[origin])


def _camera_holds(
    models: list[tuple[Problem, Light]],
    tables: list[Table],
    names: list[str],
    config: AppearanceConfig,
) -> bool:
    """Whether the response of cameras is kept."""
    # a curve of more contrast starts farther from its light: where it lags at all, its light and
    # that of the best are settled by further steps first
    camera, best = names.index(CAMERA), _best(tables, names)
    if not np.isfinite(_CAMERA_LAG[config.origin]) or not _lags(tables, camera, best):
        return not camera_lags(tables, names, config.origin)

    def solved_further(number: int) -> tuple[Problem, Light]:
        problem, light = models[number]
        start = light.amplitudes
        return problem, fit(problem, light.axes, light.sharpness, config.iterations, start=start)

    settled = list(models)
    settled[camera], settled[best] = side_by_side(solved_further, (camera, best))
    return not camera_lags(error_tables(settled), names, config.origin)


def _best(tables: list[Table], names: list[str]) -> int:
    """Number of the curve with the lowest error, a camera's response apart."""
    others = [number for number, name in enumerate(names) if name != CAMERA] or [0]
    return min(others, key=lambda number: mean_of(tables[number]))


def _lags(tables: list[Table], number: int, best: int, margin: float = SIMPLER_MARGIN) -> bool:
    """Whether the error of one curve is the greater by so many standard errors."""
    lag, error = _lag(tables[number], tables[best])
    return lag > margin * error


def _lag(table: Table, other: Table) -> tuple[float, float]:
    """By how many codes the first error is the greater, and the standard error of that."""
    error = float(np.hypot(CODE_ERROR, 255 * difference_error(table, other)))
    return 255 * (mean_of(table) - mean_of(other)), error


def fits_alike(chosen: CurveCandidate, other: CurveCandidate) -> bool:
    """Whether the photographs do not tell another curve from the chosen one."""
    return other.score - chosen.score <= SIMPLER_MARGIN * other.standard_error


def albedo_apart(chosen: CurveCandidate, other: CurveCandidate) -> float | None:
    """PSNR in dB of the albedo under one curve against that under another, one scale a channel.

    Of the unclipped samples of the light solve, under each curve's light; None without such.
    """
    (first, is_whole), (second, is_whole_too) = _albedo(chosen), _albedo(other)
    whole = is_whole & is_whole_too
    if not whole.any():
        return None
    first, second = first[whole], second[whole]
    scale = (first * second).sum(0) / (second * second).sum(0).clamp(min=1e-12)
    squared = float(((first - scale * second) ** 2).mean())
    return float(-10 * np.log10(max(squared, 1e-10)))


def _albedo(candidate: CurveCandidate) -> tuple[Tensor, Tensor]:
    """Albedo (U, 3), at most 1, and where no channel is clipped, (U,)."""
    problem, rows = candidate.problem, candidate.problem.scene.rows
    radiance = problem.rows_radiance(rows)
    albedo = log_ratio(radiance.linear, candidate.light.irradiance(problem, rows)).exp()
    return albedo.clamp(max=1.0), ~radiance.clipped.any(1)
