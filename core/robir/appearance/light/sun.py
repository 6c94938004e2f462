# SPDX-License-Identifier: Apache-2.0
"""Finding the suns: a dense scan over directions, then a shrinking search with traced rays.

A candidate adds to a grey sky and the measured bounce at one of several strengths. Its score is the
mean absolute difference of log albedo between neighbours (lobes.py). It drops sharply only near the
right direction, so the scan is dense, and candidates are blurred by its spacing.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.sparse import csr_matrix
from torch import Tensor

from robir.appearance.light.lobes import START_ALBEDO
from robir.appearance.light.pair_loss import PairWeights
from robir.appearance.light.problem import Problem
from robir.appearance.photometry.statistics import Pairs, Radiance
from robir.geometry.mesh.tracer import EmbreeTracer
from robir.maths.vectors import fibonacci_sphere, ring, tangents
from robir.transport.visibility import cosines, lobe_directions, lobe_transfer, towards_light
from robir.workers import side_by_side

Floats = NDArray[np.float32]

# irradiances of the sun at normal incidence over the mean of the base light, tried for each
# direction
_STRENGTHS = (0.25, 0.8, 2.0, 6.0)
_LIT = 0.05  # visibility times cosine above which a sample is lit
# samples that a sun lights, over those that the best placed one would. From below the ground only
# one side of what stands on it is lit, and the strength of such a light is whatever evens out the
# albedo there; the soft lobes carry it.
_LEAST_LIT = 0.4
_BLUR = 0.5  # radius of the candidates, spacings of the scan: none is stepped over
_BASIN = 1.5  # spacings of the scan within which a candidate must be the best
# angle between two suns: directions nearer than that are the same light to the scan, and a further
# sun there would only repair shadows of a wrong mesh (radians)
SEPARATION = 0.3
# directions about a candidate that are compared anew by more samples: along a shadow that runs off
# the ground those of the scan may not tell a sun from a lower place
_NUM_ALTERNATIVES = 12
_NUM_STARTS = 3  # of these, how many the search begins from
_NUM_ROUNDS = 4  # rings of the search
_SHRINKING = 0.6  # radius of a ring over that of the one before
# radius about the best trial in which a paraboloid smooths the losses. They leap wherever a
# shadow's edge steps over a sample; the lowest alone is up to a degree aside (radians)
_SMOOTHING = 0.022


@dataclass(frozen=True, slots=True, kw_only=True)
class SunProblem:
    """What the scan compares: a sub-sample of the surface."""

    position: Floats  # (U, 3) unit frame
    normal: Floats  # (U, 3) unit
    radiance: Radiance  # of the U samples
    # (U, 3) irradiance of the known lights or of a grey sky, per unit strength of that light
    base: Tensor
    indirect: Tensor  # (U, 3) irradiance from surfaces
    pairs: Pairs  # over the U samples
    tracer: EmbreeTracer | None  # tracer of the mesh, or None where nothing blocks
    offset: float  # distance that rays start above the surface
    distance: float  # of the suns from the frame's origin

    @classmethod
    def of(
        cls, problem: Problem, base: Tensor, rows: NDArray[np.int64], pairs: Pairs
    ) -> SunProblem:
        """Of some samples `rows` (U,) and pairs of them, the light `base` (S, 3) being known."""
        scene, surfels = problem.scene, problem.scene.transport.surfels
        return cls(
            position=surfels.position[rows],
            normal=surfels.normal[rows],
            radiance=problem.rows_radiance(rows),
            base=base[rows],
            indirect=problem.indirect[rows],
            pairs=pairs,
            tracer=scene.tracer,
            offset=scene.offset,
            distance=scene.light_distance,
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class SunCandidate:
    """A direction with its score."""

    axis: Floats  # (3,) float32, unit, towards the light
    loss: float  # mean absolute log difference with this sun
    gain: float  # how much lower that is than without any sun, as a share
    lit: float = 1.0  # share of the samples that it lights
    least_lit: float = 0.0  # share that it must light to be a sun
    # (R, 3) other directions that are the same light to the scan, lowest loss first
    alternatives: Floats = field(default_factory=lambda: np.zeros((0, 3), np.float32))


def candidate_loss(problem: SunProblem, transfer: Tensor) -> tuple[Tensor, Tensor]:
    """Losses (C, G) of candidates at every strength, and (1,) without a sun.

    Summed over channels; `transfer` (C, U) is visibility times cosine of each candidate.
    """
    wanted = (np.pi * problem.radiance.linear.mean(1) / START_ALBEDO).median()
    weights = PairWeights.of(problem.pairs, problem.radiance.clipped)
    # a column a strength and channel, channels fastest: short last axes are slow
    base, indirect, log_radiance = (
        part.repeat(1, len(_STRENGTHS))
        for part in (problem.base, problem.indirect, torch.log(problem.radiance.linear))
    )
    grey = problem.base.mean(1)
    strengths = torch.tensor(_STRENGTHS) * problem.base.mean()

    def losses(row: Tensor) -> Tensor:
        """Losses (G,) with one candidate's transfer (U,)."""
        middle = grey + strengths[:, None] * row
        scale = wanted / middle.median(1).values.clamp(min=1e-6)
        direct = torch.addr(base, row, strengths.repeat_interleave(3))
        irradiance = torch.addcmul(indirect, direct, scale.repeat_interleave(3))
        floor = 0.02 * irradiance.mean(0).view(-1, 3).mean(1).repeat_interleave(3)
        return weights.losses(log_radiance - 0.5 * (irradiance.square_().add_(floor**2)).log_())

    return torch.stack(side_by_side(losses, transfer)), losses(torch.zeros_like(grey))[:1]


def scan(problem: SunProblem, count: int, keep: int) -> list[SunCandidate]:
    """Lowest points of a scan of `count` directions, far enough apart to be other lights."""
    directions = fibonacci_sphere(count).numpy().astype(np.float32)
    received = np.stack(side_by_side(lambda axis: _received(problem, axis), directions))
    # blurred, the true direction lies inside the basin of its neighbours
    spacing = np.sqrt(4 * np.pi / count)
    kernel = np.exp((directions @ directions.T - 1) / (_BLUR * spacing) ** 2)
    kernel[kernel < 0.02] = 0
    kernel /= kernel.sum(1, keepdims=True)
    transfer = csr_matrix(kernel) @ received
    lit = (transfer > _LIT).mean(1)
    least_lit = _LEAST_LIT * float(lit.max())
    indices = np.flatnonzero(lit > least_lit)
    if not len(indices):
        return []
    losses, without = candidate_loss(problem, torch.from_numpy(transfer[indices]).float())
    best = losses.min(1).values
    # Of the directions about a light only the best is a candidate: a broad lamp that many of them
    # fit would else leave no room for a small one.
    useful_axes = directions[indices]
    around = torch.from_numpy(useful_axes @ useful_axes.T > np.cos(_BASIN * spacing))
    is_lowest = best <= torch.where(around, best, np.inf).min(1).values
    order = best.argsort()
    ordered, is_free = useful_axes[order], np.ones(len(order), bool)
    chosen: list[SunCandidate] = []
    for rank in np.flatnonzero(is_lowest[order].numpy()):
        if not is_free[rank]:
            continue
        axis, index = ordered[rank], int(order[rank])
        same = is_free & (ordered @ axis > np.cos(SEPARATION))
        is_free &= ~same
        same[: rank + 1] = False
        loss = float(best[index])
        chosen.append(
            SunCandidate(
                axis=axis,
                loss=loss,
                gain=1 - loss / float(without),
                lit=float(lit[indices[index]]),
                least_lit=least_lit,
                alternatives=ordered[same][:_NUM_ALTERNATIVES],
            )
        )
        if len(chosen) == keep:
            break
    return chosen


def _received(problem: SunProblem, axis: Floats) -> Floats:
    """Visibility times cosine (U,) of one direction, with its strength where it stands near."""
    ray, strength = towards_light(problem.position, axis, problem.distance)
    cosine = cosines(problem.normal, ray)
    facing = np.flatnonzero(cosine > 0)
    if problem.tracer is not None and len(facing):
        rays = np.broadcast_to(ray, problem.position.shape)[facing]
        origin = problem.position[facing] + problem.offset * problem.normal[facing]
        facing = facing[~problem.tracer.is_blocked(origin, rays)]
    received = np.zeros(len(problem.position), np.float32)
    received[facing] = (cosine * strength)[facing]
    return received


def refine(problem: SunProblem, start: SunCandidate, reach: float) -> SunCandidate:
    """Shrinking search around a direction and its alternatives, every trial traced anew.

    `reach` is the radius of the first ring, radians.
    """
    best, heads = start, _best_starts(problem, start, reach)
    tried: list[SunCandidate] = []
    for index in range(_NUM_ROUNDS):
        radius = reach * _SHRINKING**index
        sharpness = 2 / max(radius / 3, 0.01) ** 2
        trials = [
            direction
            for head in heads
            for direction in (
                head,
                *ring(head, radius, 7, 0.9 * index).astype(np.float32),
                *ring(head, radius / 2, 4, 0.5).astype(np.float32),
            )
        ]
        scored = _scored(problem, trials, sharpness)
        best = min(scored, key=lambda candidate: candidate.loss)
        heads = [best.axis]
        tried += scored
    axes = np.stack([candidate.axis for candidate in tried])
    losses = np.array([candidate.loss for candidate in tried])
    lowest = lowest_point(best.axis, axes, losses)
    return replace(best, axis=lowest, least_lit=start.least_lit)


def _scored(problem: SunProblem, axes: list[Floats], sharpness: float) -> list[SunCandidate]:
    """Directions as lobes of some sharpness, each at its best strength."""

    def traced(axis: Floats) -> Floats:
        points, lobe = (problem.position, problem.normal), lobe_directions(axis, sharpness, 4)
        return lobe_transfer(problem.tracer, *points, lobe, problem.offset, problem.distance)

    transfer = np.stack(side_by_side(traced, axes))
    losses, without = candidate_loss(problem, torch.from_numpy(transfer))
    lit = (transfer > _LIT).mean(1)
    return [
        SunCandidate(axis=axis, loss=loss, gain=1 - loss / float(without), lit=float(share))
        for axis, loss, share in zip(axes, losses.min(1).values.tolist(), lit, strict=True)
    ]


def _best_starts(problem: SunProblem, start: SunCandidate, reach: float) -> list[Floats]:
    """The best of a candidate and its rivals, none within `reach` of a better one."""
    if not len(start.alternatives):
        return [start.axis]
    scored = _scored(problem, [start.axis, *start.alternatives], 2 / reach**2)
    starts: list[Floats] = []
    for candidate in sorted(scored, key=lambda candidate: candidate.loss):
        if all(float(candidate.axis @ other) < np.cos(reach) for other in starts):
            starts.append(candidate.axis)
    return starts[:_NUM_STARTS]


def lowest_point(best: Floats, axes: Floats, losses: NDArray[np.float64]) -> Floats:
    """Lowest point (3,), unit, of a paraboloid through losses (T,) of directions (T, 3).

    At most half of `_SMOOTHING` from the best; that itself where the losses do not curve upwards.
    """
    across = np.stack(tangents(best))
    near = axes @ best > np.cos(_SMOOTHING)
    x, y = across @ axes[near].T
    terms = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=1)
    _, slope_x, slope_y, xx, xy, yy = np.linalg.lstsq(terms, losses[near], rcond=None)[0]
    curvature = np.array([[2 * xx, xy], [xy, 2 * yy]])
    if np.linalg.eigvalsh(curvature)[0] <= 0:
        return best
    step = -np.linalg.solve(curvature, [slope_x, slope_y])
    step *= min(1.0, 0.5 * _SMOOTHING / max(float(np.linalg.norm(step)), 1e-9))
    axis = best + step @ across
    return (axis / np.linalg.norm(axis)).astype(np.float32)
