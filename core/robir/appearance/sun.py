# SPDX-License-Identifier: Apache-2.0
"""Finding the suns: a dense scan over directions, then a shrinking search with traced rays.

For a candidate direction the irradiance is a grey sky plus the measured bounce plus the candidate
at one of several strengths; the score is the mean absolute difference of log albedo between
neighbours (light.py). A sun whose shadows lie where the photographs show them removes every
shadow edge at once, so its score drops sharply, and only near the right direction: the scan must be
dense, and every candidate is blurred by the spacing of the scan so that none is stepped over.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.sparse import csr_matrix
from torch import Tensor

from robir.appearance.pair_loss import PairWeights
from robir.appearance.statistics import Pairs, Radiance
from robir.maths.vectors import fibonacci_sphere
from robir.transport.tracer import AbstractTracer
from robir.transport.visibility import lobe_directions, lobe_transfer

Floats = NDArray[np.float32]

STRENGTHS = (0.25, 0.8, 2.0, 6.0)
"""Irradiance of the sun at normal incidence over the mean of the base light, tried for each
direction."""

LIT = 0.05
"""Visibility times cosine above which a sample is lit."""

LEAST_LIT = 0.4
"""Samples that a sun lights, over those that the best placed one would. From below the ground only
one side of what stands on it is lit, and the strength of such a light is whatever evens out the
albedo there; the soft lobes carry it."""

BASIN = 1.5
"""Spacings of the scan within which a candidate must be the best."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SunProblem:
    """What the scan compares: a sub-sample of the surface.

    Attributes:
        position: (U, 3) unit frame.
        normal: (U, 3) unit.
        radiance: Of the U samples.
        base: (U, 3) irradiance of the lights that are already known, or of a grey sky, per unit
            strength of that light.
        indirect: (U, 3) irradiance from surfaces.
        pairs: Over the U samples.
        tracer: Tracer of the mesh, or None where nothing blocks.
        offset: Distance that rays start above the surface.
    """

    position: Floats
    normal: Floats
    radiance: Radiance
    base: Tensor
    indirect: Tensor
    pairs: Pairs
    tracer: AbstractTracer | None
    offset: float


@dataclass(frozen=True, slots=True, kw_only=True)
class SunCandidate:
    """A direction with its score.

    Attributes:
        axis: (3,) float32, unit, towards the light.
        loss: Mean absolute log difference with this sun.
        gain: How much lower that is than without any sun, as a share.
        lit: Share of the samples that it lights.
        least_lit: Share that it must light to be a sun.
    """

    axis: Floats
    loss: float
    gain: float
    lit: float = 1.0
    least_lit: float = 0.0


def candidate_loss(problem: SunProblem, transfer: Tensor) -> tuple[Tensor, Tensor]:
    """Loss of each candidate at every strength.

    Args:
        problem: The samples.
        transfer: (C, U) visibility times cosine of each candidate.

    Returns:
        Losses (C, G) summed over channels, each channel at the strength common to all; and the
        loss (1,) without any sun.
    """
    wanted = (np.pi * problem.radiance.linear.mean(1) / 0.35).median()
    weights = PairWeights.of(problem.pairs, problem.radiance.clipped)
    # a column a strength and channel, channels fastest: short last axes are slow
    base, indirect, log_radiance = (
        part.repeat(1, len(STRENGTHS))
        for part in (problem.base, problem.indirect, torch.log(problem.radiance.linear))
    )
    grey = problem.base.mean(1)
    strengths = torch.tensor(STRENGTHS) * problem.base.mean()

    def losses(row: Tensor) -> Tensor:
        """Losses (G,) with one candidate's transfer (U,)."""
        middle = grey + strengths[:, None] * row
        scale = wanted / middle.median(1).values.clamp(min=1e-6)
        direct = torch.addr(base, row, strengths.repeat_interleave(3))
        irradiance = torch.addcmul(indirect, direct, scale.repeat_interleave(3))
        floor = 0.02 * irradiance.mean(0).view(-1, 3).mean(1).repeat_interleave(3)
        return weights.losses(log_radiance - 0.5 * (irradiance.square_().add_(floor**2)).log_())

    return torch.stack([losses(row) for row in transfer]), losses(torch.zeros_like(grey))[:1]


def scan(problem: SunProblem, count: int, keep: int) -> list[SunCandidate]:
    """Lowest points of a dense scan, far enough apart to be different lights.

    Args:
        problem: The samples.
        count: Directions over the whole sphere.
        keep: Candidates returned at most.

    Returns:
        Candidates, lowest loss first.
    """
    directions = fibonacci_sphere(count).numpy().astype(np.float32)
    bits = _trace_directions(problem, directions)
    cosine = np.clip(directions @ problem.normal.T, 0, None)
    # One spacing of blur: the true direction then lies inside the basin of its neighbours.
    spacing = np.sqrt(4 * np.pi / count)
    kernel = np.exp((directions @ directions.T - 1) / (0.5 * spacing) ** 2)
    kernel[kernel < 0.02] = 0
    kernel /= kernel.sum(1, keepdims=True)
    transfer = csr_matrix(kernel) @ (bits * cosine)
    lit = (transfer > LIT).mean(1)
    least_lit = LEAST_LIT * float(lit.max())
    indices = np.flatnonzero(lit > least_lit)
    if not len(indices):
        return []
    losses, without = candidate_loss(problem, torch.from_numpy(transfer[indices]).float())
    best = losses.min(1).values
    # Of the directions about a light only the best is a candidate: a broad lamp that many of them
    # fit would else leave no room for a small one.
    useful_axes = directions[indices]
    around = torch.from_numpy(useful_axes @ useful_axes.T > np.cos(BASIN * spacing))
    is_lowest = best <= torch.where(around, best, np.inf).min(1).values
    order = best.argsort()
    chosen: list[SunCandidate] = []
    for index in order[is_lowest[order]].tolist():
        axis = useful_axes[index]
        if any(float(axis @ other.axis) > np.cos(0.3) for other in chosen):
            continue
        loss = float(best[index])
        chosen.append(
            SunCandidate(
                axis=axis,
                loss=loss,
                gain=1 - loss / float(without),
                lit=float(lit[indices[index]]),
                least_lit=least_lit,
            )
        )
        if len(chosen) == keep:
            break
    return chosen


def _trace_directions(problem: SunProblem, directions: Floats) -> Floats:
    """Visibility (D, U) as 0 or 1 for every direction."""
    bits = np.zeros((len(directions), len(problem.position)), np.float32)
    origin = problem.position + problem.offset * problem.normal
    for index, direction in enumerate(directions):
        facing = np.flatnonzero(problem.normal @ direction > 0)
        if problem.tracer is not None and len(facing):
            rays = np.broadcast_to(direction, (len(facing), 3))
            facing = facing[~problem.tracer.is_blocked(origin[facing], rays)]
        bits[index, facing] = 1
    return bits


def refine(problem: SunProblem, start: SunCandidate, reach: float, rounds: int) -> SunCandidate:
    """Shrinking search around a direction, every trial traced anew.

    Args:
        problem: The samples, more than the scan's.
        start: Where to begin.
        reach: Radius of the first ring, radians.
        rounds: Rings; each has 0.6 of the last one's radius.

    Returns:
        The best direction found.
    """
    best = start
    best_loss = np.inf
    for index in range(rounds):
        radius = reach * 0.6**index
        trials = [
            best.axis,
            *_ring(best.axis, radius, 7, 0.9 * index),
            *_ring(best.axis, radius / 2, 4, 0.5),
        ]
        sharpness = 2 / max(radius / 3, 0.01) ** 2
        transfer = np.stack(
            [
                lobe_transfer(
                    problem.tracer,
                    problem.position,
                    problem.normal,
                    lobe_directions(trial, sharpness, 4),
                    problem.offset,
                )
                for trial in trials
            ]
        )
        losses, without = candidate_loss(problem, torch.from_numpy(transfer))
        flat = int(losses.min(1).values.argmin())
        best_loss = float(losses[flat].min())
        best = SunCandidate(
            axis=trials[flat],
            loss=best_loss,
            gain=1 - best_loss / float(without),
            lit=float((transfer[flat] > LIT).mean()),
            least_lit=start.least_lit,
        )
    return best


def _ring(axis: Floats, radius: float, count: int, turn: float) -> list[Floats]:
    """Directions on a circle about an axis."""
    helper = np.eye(3)[np.abs(axis).argmin()]
    tangent = np.cross(axis, helper)
    tangent /= np.linalg.norm(tangent)
    bitangent = np.cross(axis, tangent)
    angles = turn + np.arange(count) * 2 * np.pi / count
    ring = np.cos(radius) * axis + np.sin(radius) * (
        np.cos(angles)[:, None] * tangent + np.sin(angles)[:, None] * bitangent
    )
    return [direction.astype(np.float32) for direction in ring]
