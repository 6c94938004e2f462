# SPDX-License-Identifier: Apache-2.0
"""Fit of the distance field to the photographs, coarse to fine."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import torch
from torch import Tensor

from robir.errors import QualityError
from robir.geometry.config import GeometryConfig
from robir.geometry.fit.field import ColourNetwork, Field
from robir.geometry.fit.preview import Present
from robir.geometry.fit.sampling import Intervals, Occupancy, march
from robir.geometry.lattice import Lattice, Sampled, neighbour_mean, smoothed
from robir.geometry.rays import RaySampler
from robir.maths.adam import Adam
from robir.workers import blocks, side_by_side

_FEATURES = 8  # colour features of a node of the field
_SOFT_PASSES = 6  # passes of the (1, 2, 1) / 4 filter that frees the surface of small lumps
_FIRST_SHARPNESS = 30.0  # NeuS steepness at the start, for an object of longest side 2
_LAST_SHARPNESS = 160.0  # the same at the end
_SHARPEST_AT = 0.85  # share of the fit from which it is the last one
_BAND = 5.0  # distance from the surface that rays are sampled in, in widths of the soft surface
_MASK_WEIGHT = 0.2  # weight of the coverage's cross-entropy against the colour
_FULL_COVERAGE = 0.98  # from which coverage counts as full: what dropped intervals leave of it
_RAYS_TOGETHER = 1024  # rays that a thread works on at a time
_REFRESH = 25  # between updates of the occupancy and of the nodes that carry features (steps)
_SMOOTH_EVERY = 10  # between the proximal steps on the field
# share of the way towards its neighbours' mean that such a step moves a node at the start; it
# falls to 0. Early steps are large and noisy, and lumps that stay where the colour decides little
# are dug further by the colours learnt on them; but smoothing shrinks what is round.
_SMOOTHING = 0.5
# share of the way that every such step moves a node there and back, which takes what is rough and
# leaves what is round (Taubin 1995, "A signal processing approach to fair surface design")
_FAIRING = 0.25
# of the distances where gradients agree, at the coarsest level, which has to leave the visual
# hull (cells a step)
_FIRST_DISTANCE_RATE = 0.5
_DISTANCE_RATE = 0.375  # the same at the other levels (cells a step)
_GRADIENT_PASSES = 2  # passes of the (1, 2, 1) / 4 filter over the gradient of the distances
_DECAYS = (0.9, 0.99)  # of the first and second moment, of distances, features and network
# decay of the mean gradient that tells whether gradients agree: over 50 steps every spot is seen
# from many sides
_MEMORY = 0.98
# agreement, in multiples of what gradients of random sign show by chance, at which the step is
# halved. Chance alone then leaves a tenth of the step, ten times chance all but a tenth.
_DOUBT = 3.0
_FEATURE_RATE = 0.3  # Adam's rate of the features
# Adam's rate of the network: reflections must be learnt before the surface is dug for them
_NETWORK_RATE = 0.01
_DECAY_FROM = 0.3  # share of the fit from which all rates fall
_LAST_RATE = 0.05  # share of the rates that is left at the end


class _Optimiser:
    """Adam over field and network, whose state follows the nodes and the rows of the features.

    The gradient of the distances is smoothed first, so that the surface moves in patches rather
    than node by node (after Nicolet et al. 2021, "Large steps in inverse rendering of geometry").
    What the colours cannot follow, highlights above all, pushes the surface to and fro as rays come
    and go: Adam would dig lumps that nothing levels again, so a node's step is as long as its
    gradients of many steps agree.
    """

    def __init__(self, field: Field, network: ColourNetwork, rate: float) -> None:
        self._sdf, self._lattice = field.sdf, field.lattice
        self._reach = rate * field.lattice.cell
        self._moments = torch.zeros(3, field.lattice.count, device=field.sdf.device)
        self._taken = 0
        self._rates = (_FEATURE_RATE, *(_NETWORK_RATE for _ in network.parameters()))
        self._adam = Adam([field.features, *network.parameters()], _DECAYS)

    def follow(self, field: Field, wanted: Tensor, old_rows: Tensor) -> None:
        """Go on with the nodes (N,) bool that carry features; the others keep their moments."""
        self._nodes = wanted.nonzero()[:, 0]
        self._adam.replace(0, field.features, old_rows)

    def step(self, factor: float) -> None:
        """One step against the gradients, with every learning rate times `factor`."""
        self._move_distances(factor * self._reach)
        self._adam.step([factor * rate for rate in self._rates])

    @torch.no_grad()
    def _move_distances(self, rate: float) -> None:
        """Adam's step on the nodes that are followed."""
        assert self._sdf.grad is not None
        gradient = smoothed(self._sdf.grad, self._lattice, _GRADIENT_PASSES)
        gradient = gradient.index_select(0, self._nodes)  # a third of the time of square brackets
        self._sdf.grad = None
        self._taken += 1
        first, second, lasting = self._moments.index_select(1, self._nodes)
        for mean, decay in ((first, _DECAYS[0]), (lasting, _MEMORY)):
            mean.lerp_(gradient, 1.0 - decay)
        second.lerp_(gradient.square(), 1.0 - _DECAYS[1])
        self._moments.index_copy_(1, self._nodes, torch.stack([first, second, lasting]))
        square = second.div_(1.0 - _DECAYS[1] ** self._taken)
        share = agreement(lasting.div_(1.0 - _MEMORY**self._taken), square, self._taken)
        way = first.mul_(share).div_(square.sqrt_().add_(1e-8))
        way *= -rate / (1.0 - _DECAYS[0] ** self._taken)
        self._sdf.index_add_(0, self._nodes, way)


def agreement(mean: Tensor, square: Tensor, taken: int) -> Tensor:
    """How far gradients agree, as the share (K,) of a step that may be made, in [0, 1].

    Of the mean (K,) of so many gradients, weights decaying by `_MEMORY`, and of their squares'
    (K,).
    """
    left = _MEMORY**taken
    chance = (1.0 - _MEMORY) / (1.0 + _MEMORY) * (1.0 + left) / (1.0 - left)
    # nodes that no ray has met yet have no gradient
    odds = (mean.square() / (square * (_DOUBT * chance)).clamp_(min=1e-30)).square_()
    return odds / (1.0 + odds)


def smooth(sdf: Tensor, lattice: Lattice, share: float) -> None:
    """The proximal step at a share of the fit, in place on distances (N,).

    Inside Adam the gradients of a regulariser at rarely sampled nodes are blown up to full steps;
    as steps of their own on the whole lattice they do what their formula says.
    """
    first, grid = _SMOOTHING * (1.0 - share) ** 2, sdf.view(lattice.shape)
    for amount in (first, _FAIRING, -_FAIRING):
        grid.lerp_(neighbour_mean(grid), amount)


def _loss(predicted: tuple[Tensor, Tensor], target: Tensor) -> Tensor:
    """Robust colour loss (Charbonnier) plus cross-entropy of the coverage."""
    # at the photograph's own coverage: a surface that lets a little light through must not be
    # pushed to and fro by its colour's brightness. What is full but for dropped intervals counts as
    # full, or it would inflate the surface for ever.
    rgb, coverage = predicted
    wanted = target[:, 3]
    colour = ((rgb * wanted[:, None] - target[:, :3]) ** 2 + 1e-4).sqrt().mean()
    mask = torch.nn.functional.binary_cross_entropy(
        coverage.clamp(1e-3, _FULL_COVERAGE), wanted.clamp(max=_FULL_COVERAGE)
    )
    return colour + _MASK_WEIGHT * mask


def _descend(
    field: Field, network: ColourNetwork, soft: tuple[Occupancy, float], rays: tuple[Tensor, ...]
) -> Tensor:
    """Loss of rays (origins, directions, targets, jitter); field and network take its gradients."""
    (occupancy, inv_std), count = soft, len(rays[0])
    parameters = list(network.parameters())

    def block(part: slice) -> tuple[Intervals, Tensor, tuple[Tensor, ...]]:
        origins, directions, target, jitter = (values[part] for values in rays)
        intervals = march(occupancy, field.sdf, inv_std, origins, directions, jitter)
        looked_up = field.looked_up(intervals)
        predicted = field.render(intervals, looked_up, network, (origins, directions), inv_std)
        loss = _loss(predicted, target) * (len(target) / count)
        return intervals, loss.detach(), torch.autograd.grad(loss, [*looked_up, *parameters])

    # a graphics card does them all at once
    size = _RAYS_TOGETHER if field.sdf.device.type == "cpu" else count
    intervals, losses, slopes = zip(*side_by_side(block, blocks(count, size)), strict=True)
    field.take_slopes(intervals, [one[:2] for one in slopes])
    for values, *parts in zip(parameters, *(one[2:] for one in slopes), strict=True):
        values.grad = torch.stack(parts).sum(0)
    return torch.stack(losses).sum()


def _steepness(share: float, longest: float) -> float:
    """NeuS steepness at a share of the fit, 1 / unit frame, by the object's longest side."""
    first, last = _FIRST_SHARPNESS, _LAST_SHARPNESS
    growth = (last / first) ** min(share / _SHARPEST_AT, 1.0)
    return first * growth * 2.0 / longest


def _rate_factor(share: float) -> float:
    """What is left of all rates at a share of the fit."""
    late = max(0.0, (share - _DECAY_FROM) / (1.0 - _DECAY_FROM))
    return math.exp(math.log(_LAST_RATE) * late)


def _occupied(field: Field, inv_std: float) -> Occupancy:
    """Where the soft surface of a field may be."""
    band = _BAND / inv_std + field.lattice.cell
    return Occupancy.of(field.lattice, field.sdf.detach(), band)


def _present(field: Field, network: ColourNetwork, occupancy: Occupancy, inv_std: float) -> Present:
    """The present field, for those who look on."""

    def render(origins: Tensor, directions: Tensor) -> tuple[Tensor, Tensor]:
        middle = torch.full_like(origins[:, 0], 0.5)
        intervals = march(occupancy, field.sdf, inv_std, origins, directions, middle)
        looked_up = field.looked_up(intervals)
        return field.render(intervals, looked_up, network, (origins, directions), inv_std)

    return Present(render, Sampled(field.lattice, field.sdf.detach()))


def fit(
    sampler: RaySampler,
    start: Sampled,
    config: GeometryConfig,
    generator: torch.Generator,
    progress: Callable[[float, Present], None],
    settle: Callable[[Field, ColourNetwork], bool],
) -> Field:
    """Fit a field to the rays of a capture, from the lattice and distances of `start` on.

    `progress` is called after every few steps with the share done and the field as it is, and with
    1.0 when it is settled. `settle` is called with field and network at the end of every level and
    may change the field's distances in place; the fit ends there if it returns True. The field of
    that level, or of the finest. `QualityError` if the loss stops being a number.
    """
    lattice, sdf = start
    device = str(sdf.device)
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(int(torch.randint(1 << 31, (1,), generator=generator)))
        network = ColourNetwork(_FEATURES).to(device)
    total, done = sum(config.level_steps), 0
    field = Field(lattice, sdf, _FEATURES, _SOFT_PASSES)
    longest = float((lattice.upper - lattice.lower).max()) - 6 * lattice.cell
    for cells, steps in zip(config.level_cells, config.level_steps, strict=True):
        inset = 3 * lattice.cell
        level = Lattice.around(np.array(lattice.lower) + inset, lattice.upper - inset, cells)
        field = field.refined(level)
        rate = _DISTANCE_RATE if done else _FIRST_DISTANCE_RATE
        optimiser = _Optimiser(field, network, rate)
        occupancy: Occupancy | None = None
        for step in range(steps):
            share = done / total
            inv_std = _steepness(share, longest)
            if occupancy is None or step % _REFRESH == 0:
                occupancy = _occupied(field, inv_std)
                wanted = level.dilated(occupancy.near, 1)
                optimiser.follow(field, wanted, field.place_features(wanted))
                progress(share, _present(field, network, occupancy, inv_std))
            drawn = sampler.draw(config.rays)
            jitter = torch.rand(len(drawn[0]), generator=generator).to(device)
            loss = _descend(field, network, (occupancy, inv_std), (*drawn, jitter))
            optimiser.step(_rate_factor(share))
            done += 1
            if done % _SMOOTH_EVERY == 0:
                if not math.isfinite(loss.item()):
                    raise QualityError("The geometry fit diverged: its loss is no longer a number.")
                with torch.no_grad():
                    smooth(field.sdf, level, done / total)
                    field.soften()
        if settle(field, network):
            return field
    inv_std = _steepness(1.0, longest)
    progress(1.0, _present(field, network, _occupied(field, inv_std), inv_std))
    return field
