# SPDX-License-Identifier: Apache-2.0
"""Fit of the distance field to the photographs, coarse to fine."""

from __future__ import annotations

import math
from collections.abc import Callable

import torch
from torch import Tensor

from robir.errors import QualityError
from robir.geometry.config import GeometryConfig
from robir.geometry.fit.config import FitConfig, OptimiseConfig
from robir.geometry.fit.descent import Descent
from robir.geometry.fit.field import ColourNetwork, Field
from robir.geometry.fit.field_preview import Present
from robir.geometry.fit.regularise import laplacian_step
from robir.geometry.fit.sampling import Occupancy, march
from robir.geometry.lattice import Lattice, Sampled
from robir.geometry.rays import RaySampler
from robir.maths.adam import Adam

_FEATURES = 0
"""Where Adam keeps the features."""


class _Optimiser:
    """Adam over field and network, whose state follows the rows of the features.

    Args:
        field: Field of the present level.
        network: Colour network.
        rate: Rate of the distances, cells a step.
        config: The other rates, and their decays.
    """

    def __init__(
        self, field: Field, network: ColourNetwork, rate: float, config: FitConfig
    ) -> None:
        self._descent = Descent(field.sdf, field.lattice, config.descent)
        self._reach = rate * field.lattice.cell
        of_network = config.optimise.network_rate
        self._rates = (config.optimise.feature_rate, *(of_network for _ in network.parameters()))
        decays = (config.descent.first_decay, config.descent.second_decay)
        self._adam = Adam([field.features, *network.parameters()], decays)

    def follow(self, field: Field, wanted: Tensor, old_rows: Tensor) -> None:
        """Go on with the nodes that carry features; moments go along."""
        self._descent.follow(wanted)
        self._adam.replace(_FEATURES, field.features, old_rows)

    def step(self, loss: Tensor, factor: float) -> None:
        """One step with every learning rate times `factor`."""
        loss.backward()
        self._descent.step(factor * self._reach)
        self._adam.step([factor * rate for rate in self._rates])


def smooth(sdf: Tensor, lattice: Lattice, share: float, config: OptimiseConfig) -> None:
    """The proximal step, in place.

    Args:
        sdf: (N,) signed distances.
        lattice: Nodes.
        share: Share of all steps of the fit that are done.
        config: How far.
    """
    first = config.smoothing * (1.0 - share) ** 2
    for amount in (first, config.fairing, -config.fairing):
        laplacian_step(sdf, lattice, amount)


def _loss(predicted: tuple[Tensor, Tensor], target: Tensor, config: OptimiseConfig) -> Tensor:
    """Robust colour loss (Charbonnier) plus cross-entropy of the coverage.

    The colour is compared at the photograph's own coverage: a surface that lets a little light
    through must not be pushed to and fro by the brightness of its colour. Coverage that is full
    but for the dropped intervals counts as full, or it would inflate the surface for ever.
    """
    rgb, coverage = predicted
    wanted = target[:, 3]
    colour = ((rgb * wanted[:, None] - target[:, :3]) ** 2 + 1e-4).sqrt().mean()
    full = config.full_coverage
    mask = torch.nn.functional.binary_cross_entropy(
        coverage.clamp(1e-3, full), wanted.clamp(max=full)
    )
    return colour + config.mask_weight * mask


def _steepness(share: float, longest: float, config: OptimiseConfig) -> float:
    """NeuS steepness at a share of the fit, 1 / unit frame, by the object's longest side."""
    first, last = config.first_sharpness, config.last_sharpness
    growth = (last / first) ** min(share / config.sharpest_at, 1.0)
    return first * growth * 2.0 / longest


def _rate_factor(share: float, config: OptimiseConfig) -> float:
    """What is left of all rates at a share of the fit."""
    late = max(0.0, (share - config.decay_from) / (1.0 - config.decay_from))
    return math.exp(math.log(config.last_rate) * late)


def _occupied(field: Field, inv_std: float, config: FitConfig) -> Occupancy:
    """Where the soft surface of a field may be."""
    band = config.optimise.band / inv_std + field.lattice.cell
    return Occupancy.of(field.lattice, field.sdf.detach(), band, config.sampling)


def _refresh(field: Field, optimiser: _Optimiser, inv_std: float, config: FitConfig) -> Occupancy:
    """Update the band around the surface and the nodes that carry features."""
    occupancy = _occupied(field, inv_std, config)
    wanted = field.lattice.dilated(occupancy.near, 1)
    optimiser.follow(field, wanted, field.place_features(wanted))
    return occupancy


def _present(field: Field, network: ColourNetwork, occupancy: Occupancy, inv_std: float) -> Present:
    """The present field, for those who look on."""

    def render(origins: Tensor, directions: Tensor) -> tuple[Tensor, Tensor]:
        middle = torch.full_like(origins[:, 0], 0.5)
        intervals = march(occupancy, field.sdf, inv_std, origins, directions, middle)
        return field.render(intervals, network, (origins, directions), inv_std)

    return Present(render, Sampled(field.lattice, field.sdf.detach()))


def fit(
    sampler: RaySampler,
    start: Sampled,
    config: GeometryConfig,
    generator: torch.Generator,
    progress: Callable[[float, Present], None],
    settle: Callable[[Field, ColourNetwork], bool],
) -> Field:
    """Fit a field to the rays of a capture.

    Args:
        sampler: Source of rays.
        start: Lattice and signed distances to start from, usually the visual hull.
        config: Levels, steps, rays.
        generator: Source of the samples' jitter and of the network's weights, on the CPU.
        progress: Called after every few steps with the share done and the field as it is, and
            with 1.0 when it is settled.
        settle: Called with field and network at the end of every level, may change the field's
            distances in place; the fit ends there if it returns True.

    Returns:
        The field of the finest level, or of that at which it was ended.

    Raises:
        QualityError: If the loss stops being a number.
    """
    lattice, sdf = start
    device = str(sdf.device)
    rules = config.fit.optimise
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(int(torch.randint(1 << 31, (1,), generator=generator)))
        network = ColourNetwork(config.features, config.fit.field).to(device)
    total, done = sum(config.level_steps), 0
    field = Field(lattice, sdf, config.features, config.fit.field.soft_passes)
    longest = float((lattice.upper - lattice.lower).max()) - 6 * lattice.cell
    for cells, steps in zip(config.level_cells, config.level_steps, strict=True):
        level = Lattice.around(
            torch.tensor(lattice.lower).numpy() + 3 * lattice.cell,
            lattice.upper - 3 * lattice.cell,
            cells,
        )
        field = field.refined(level)
        rate = rules.distance_rate if done else rules.first_distance_rate
        optimiser = _Optimiser(field, network, rate, config.fit)
        occupancy: Occupancy | None = None
        for step in range(steps):
            share = done / total
            inv_std = _steepness(share, longest, rules)
            if occupancy is None or step % rules.refresh == 0:
                occupancy = _refresh(field, optimiser, inv_std, config.fit)
                progress(share, _present(field, network, occupancy, inv_std))
            origins, directions, target = sampler.draw(config.rays)
            jitter = torch.rand(len(origins), generator=generator).to(device)
            intervals = march(occupancy, field.sdf, inv_std, origins, directions, jitter)
            predicted = field.render(intervals, network, (origins, directions), inv_std)
            loss = _loss(predicted, target, rules)
            optimiser.step(loss, _rate_factor(share, rules))
            done += 1
            if done % rules.smooth_every == 0:
                if not math.isfinite(loss.item()):
                    raise QualityError("The geometry fit diverged: its loss is no longer a number.")
                with torch.no_grad():
                    smooth(field.sdf, level, done / total, rules)
                    field.soften()
        if settle(field, network):
            return field
    inv_std = _steepness(1.0, longest, rules)
    progress(1.0, _present(field, network, _occupied(field, inv_std, config.fit), inv_std))
    return field
