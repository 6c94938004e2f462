# SPDX-License-Identifier: Apache-2.0
"""The light: fixed soft lobes for the sky, a few free sharp lobes for suns and lamps.

Irradiance is linear in the amplitudes. As cameras measure the exitant radiance R of a diffuse
sample, its albedo is the ratio a = pi R / E, and only the light is searched (variable elimination),
by priors on log a. Absolute differences between neighbours do not saturate, so a light that leaves
every shadow in the albedo pays for every shadow.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from torch import Tensor

from robir.appearance.light.pair_loss import PairWeights
from robir.appearance.photometry.statistics import Pairs, Radiance
from robir.maths.adam import Adam
from robir.maths.daylight import PART, SUN, WHOLE
from robir.maths.spherical_gaussian import SphericalGaussians, amplitude_from_irradiance
from robir.maths.vectors import fibonacci_sphere
from robir.transport.surfels import Surfels
from robir.transport.visibility import Visibility
from robir.workers import blocks, side_by_side


@dataclass(frozen=True, slots=True, kw_only=True)
class LightPrior:
    """Of the mean irradiance that sky and suns send to the samples that take part."""

    # (3,) of its logarithm, less the mean over the channels; None if not known
    hue: Tensor | None = None
    hue_error: float = 1.0  # one standard deviation of each channel of that
    level: float | None = None  # mean over the channels of its logarithm; None if not known
    level_error: float = 1.0  # one standard deviation of that

    def missing(self, sent: Tensor) -> Tensor:
        """Log factors (3,) that a light is short of this, which sends `sent` (3,), a logarithm."""
        return self._hue_missing(sent) + self._level_missing(sent)

    def squared(self, sent: Tensor) -> Tensor:
        """Squared deviations of such a light from this, added up."""
        hue = (self._hue_missing(sent) ** 2).sum() / self.hue_error**2
        return hue + (self._level_missing(sent) / self.level_error) ** 2

    def _hue_missing(self, sent: Tensor) -> Tensor:
        if self.hue is None:
            return torch.zeros_like(sent)
        return self.hue - (sent - sent.mean())

    def _level_missing(self, sent: Tensor) -> Tensor:
        if self.level is None:
            return torch.zeros(())
        return self.level - sent.mean()


NO_PRIOR = LightPrior()


_DRAWS = 8  # partners of a sample: the nearest in hue of as many draws, so that they lie all over

_SHARE = 8  # a draw is one sample in so many

_FEWEST = 60  # samples of a draw at least; with fewer than twice as many in all there are no pairs

_FAR_HUE = 0.06  # difference of two log chromaticities at which a pair counts exp(-1/2)


def far_pairs(log_albedo: Tensor, whole: Tensor) -> Pairs | None:
    """Pairs of one hue among samples of log albedo (U, 3), those most alike counting most.

    Neighbours do not see the shading of a smooth thing. Two samples of one hue are often of one
    material and as bright as each other under the right light; hue is nearly right under a
    half-solved light. Of the samples `whole` (W,), of which no channel is clipped; None with too
    few.
    """
    if len(whole) < 2 * _FEWEST:
        return None
    values, rows = log_albedo.numpy(), whole.numpy()
    hue = np.stack([values[:, 0] - values[:, 1], values[:, 2] - values[:, 1]], axis=1)[rows]
    rng, every = np.random.default_rng(0), np.arange(len(rows))
    partners = [_nearest(hue, rng) for _ in range(_DRAWS)]
    first, second = np.tile(every, _DRAWS), np.concatenate(partners)
    apart = first != second
    first, second = first[apart], second[apart]
    squared = ((hue[first] - hue[second]) ** 2).sum(1)
    weight = torch.from_numpy(np.exp(-0.5 * squared / _FAR_HUE**2).astype(np.float32))
    pairs = Pairs(
        first=torch.from_numpy(rows[first]), second=torch.from_numpy(rows[second]), weight=weight
    )
    return pairs.weighted(torch.ones_like(weight))


def _nearest(hue: NDArray[np.float32], rng: np.random.Generator) -> NDArray[np.int64]:
    """The nearest in hue (W, 2) to every sample among those drawn, (W,)."""
    drawn = rng.choice(len(hue), max(_FEWEST, len(hue) // _SHARE), replace=False)
    return drawn[cKDTree(hue[drawn]).query(hue)[1]]


# Sharpness of a soft lobe per number of lobes: neighbours then overlap at 60 % of their peak. It
# says what amplitudes of a light mean.
SOFT_SHARPNESS_PER_LOBE = 0.17

MEAN_ALBEDO = 0.3  # geometric mean of the albedos of common scenes
START_ALBEDO = 0.35  # median albedo under the light that a search begins with
BRIGHTEST_QUANTILE = 0.97  # rank of the albedos that counts as the brightest
_BRIGHTEST = 0.9  # albedo that the brightest materials should not exceed
_BOUNDS = 1.0  # weight of staying within a physical range
# weight of hues that lights have (maths/daylight.py), per squared deviation: of the light as a
# whole, since surfaces that do not shine do not tell it from that of all albedos, and under a tint
# bounced light is judged wrongly; and of suns against the sky
_HUE = 0.0024
_PART = 0.005  # the same of the sky's lobes against their mean, per deviation
_SMOOTH = 0.01  # weight of neighbouring soft lobes being alike
# weight of no bright soft lobes where few samples see them, as below the ground. They could else be
# as bright as it takes to shade what is painted.
_SPREAD = 0.1
_SHADOW = 0.25  # weight of equal albedo on both sides of a shadow
_SAMPLES = 4096  # whose sky is added up at a time
_NEAR_SAMPLES = 32  # the same of one near by: their rays stay in the processor's cache
_RATE = 0.06  # learning rate of the first step; it falls to a tenth


@dataclass(frozen=True, kw_only=True)
class Transfer:
    """Irradiance at the samples that take part, per unit of each light."""

    soft: Tensor  # (U, K) for unit amplitude of each soft lobe
    sharp: Tensor  # (U, J) for unit energy of each sharp lobe, visibility included
    indirect: Tensor  # (U, 3) from surfaces, fixed by the photographs
    # (U,) bool, where an error of the mesh neither gives nor takes a sun; all if None
    certain: Tensor | None = None

    @cached_property
    def soft_rows(self) -> Tensor:
        """The soft transfer with a row (U,) a lobe."""
        return self.soft.T.contiguous()


@dataclass(frozen=True, slots=True, kw_only=True)
class Amplitudes:
    """Strength of the lights."""

    soft: Tensor  # (K, 3) radiance at the lobe's peak
    sharp: Tensor  # (J, 3) irradiance at normal incidence

    def irradiance(self, transfer: Transfer) -> Tensor:
        """Irradiance (U, 3) at the samples of a transfer."""
        sky = _ThinProduct.apply(transfer.soft, transfer.soft_rows, self.soft)
        return sky + transfer.sharp @ self.sharp + transfer.indirect


class _ThinProduct(torch.autograd.Function):
    """Matrix (U, K) by a few columns (K, C), differentiable in those."""

    # a product of few rows takes a quarter of the time of one of few columns

    @staticmethod
    def forward(ctx: Any, matrix: Tensor, matrix_rows: Tensor, columns: Tensor) -> Tensor:
        ctx.matrix = matrix
        return (columns.T @ matrix_rows).T.contiguous()

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> tuple[None, None, Tensor]:
        return None, None, (gradients[0].T @ ctx.matrix).T


def soft_lobes(count: int) -> tuple[Tensor, float]:
    """Axes (K, 3) and the common sharpness of the fixed soft lobes."""
    return fibonacci_sphere(count).float(), max(1.0, SOFT_SHARPNESS_PER_LOBE * count)


def sky_radiance(directions: Tensor, amplitudes: Tensor) -> Tensor:
    """Radiance (D, ...) of the soft lobes of amplitudes (K, ...) from directions (D, 3)."""
    axes, sharpness = soft_lobes(len(amplitudes))
    return torch.exp(sharpness * (directions @ axes.T - 1)) @ amplitudes


def soft_transfer(
    visibility: Visibility, surfels: Surfels, count: int, distance: float = np.inf
) -> Tensor:
    """Irradiance (S, count) at all samples for unit amplitude of soft lobes.

    Equation (1) of transport. The lobes shine from a sphere of radius `distance` about the origin
    of the frame: a direction meets it elsewhere from each point.
    """
    axes, sharpness = soft_lobes(count)
    directions = torch.from_numpy(visibility.directions)
    share, along_axes = 4 * np.pi / len(directions), directions @ axes.T
    afar = torch.exp(sharpness * (along_axes - 1))

    def received(part: slice) -> Tensor:
        bits = np.unpackbits(visibility.bits[part], axis=1, count=len(directions))
        cosine = torch.from_numpy(surfels.normal[part]) @ directions.T
        weight = share * torch.from_numpy(bits).float() * cosine.clamp(min=0)
        if np.isinf(distance):
            return weight @ afar
        # a ray meets the sphere at p + r w, so that a lobe of axis a has there
        # exp(s ((p + r w) . a / distance - 1))
        position = torch.from_numpy(surfels.position[part])
        along = position @ directions.T
        beyond = distance**2 - (position**2).sum(1, keepdim=True)
        reach = (along**2 + beyond).clamp(min=0).sqrt() - along
        lobes = ((sharpness / distance) * reach[..., None] * along_axes).exp_()
        offset = torch.exp(sharpness * (position @ axes.T / distance - 1))
        return torch.bmm(weight[:, None], lobes)[:, 0] * offset

    size = _SAMPLES if np.isinf(distance) else _NEAR_SAMPLES
    return torch.cat(side_by_side(received, blocks(len(surfels), size)))


def log_ratio(radiance: Tensor, irradiance: Tensor) -> Tensor:
    """Logarithm of albedo, log(pi R / E), kept finite where hardly any light arrives.

    The floor goes up with the light, for gradients too: else deep shadows, whose albedo it holds,
    would ask for ever more sun, which seems to darken nothing but what is lit.
    """
    floor = 0.02 * irradiance.mean(0)
    return torch.log(np.pi * radiance) - 0.5 * torch.log(irradiance**2 + floor**2)


def log_sent(irradiance: Tensor, indirect: Tensor) -> Tensor:
    """Log (3,) of the mean irradiance (U, 3) of sky and suns; less its mean, the light's hue."""
    return (irradiance - indirect).mean(0).log()


@dataclass(frozen=True, slots=True, kw_only=True)
class Priors:
    """What a solve knows of albedo and light beforehand."""

    # prior of the light as a whole; it weighs as `_HUE` does, per squared deviation
    light: LightPrior = NO_PRIOR
    far: float = 0.0  # weight of equal albedo where the hue is one, see `far_pairs`
    # weight of equal albedo on both sides of a shadow
    shadow: float = field(default_factory=lambda: _SHADOW)
    # weight of neighbouring soft lobes being alike
    smooth: float = field(default_factory=lambda: _SMOOTH)


def solve_amplitudes(
    radiance: Radiance,
    transfer: Transfer,
    pairs: tuple[Pairs, Pairs],
    priors: Priors,
    iterations: int,
    start: Amplitudes | None = None,
) -> tuple[Amplitudes, float]:
    """Light strengths whose eliminated albedo is the most plausible, and the neighbour loss.

    All is of the samples that take part (U,); `pairs` are neighbours among them, and pairs across
    shadows. Adam begins at `start`, or at a neutral sky with equally strong suns.
    """
    num_soft, num_sharp = transfer.soft.shape[1], transfer.sharp.shape[1]
    renewed = {0, iterations // 3, 2 * iterations // 3}
    if start is None:
        renewed.remove(0)  # nothing is known of the light yet
        start = neutral_start(radiance, transfer, START_ALBEDO)
    log_soft = start.soft.clamp(min=1e-6).log().requires_grad_(True)
    log_sharp = start.sharp.clamp(min=1e-6).log().requires_grad_(True)
    optimiser = Adam([log_soft, log_sharp], (0.9, 0.98))
    reaching = transfer.soft.mean(0)
    hidden = 1 - reaching / reaching.max()
    axes, _ = soft_lobes(num_soft)
    near = (axes @ axes.T).fill_diagonal_(-1).topk(min(4, num_soft)).indices
    loss_value = 0.0
    neighbours, across = (PairWeights.of(part, radiance.clipped) for part in pairs)
    whole = torch.nonzero(~radiance.clipped.any(1))[:, 0]
    alike: PairWeights | None = None
    count = len(radiance.seen)
    certain = (
        torch.arange(count) if transfer.certain is None else torch.nonzero(transfer.certain)[:, 0]
    )
    for step in range(iterations):
        fraction = step / max(1, iterations - 1)
        amplitudes = Amplitudes(soft=log_soft.exp(), sharp=log_sharp.exp())
        irradiance = amplitudes.irradiance(transfer)
        log_albedo = log_ratio(radiance.linear, irradiance)
        neighbour = neighbours.loss(log_albedo)
        loss = neighbour + priors.shadow * across.loss(log_albedo)
        if priors.far and step in renewed and (pairs_far := far_pairs(log_albedo.detach(), whole)):
            alike = PairWeights.of(pairs_far, radiance.clipped)
        if alike is not None:
            loss = loss + priors.far * alike.loss(log_albedo)
        loss = loss + _BOUNDS * range_loss(log_albedo, (whole, certain), priors)
        sky = torch.log(amplitudes.soft.mean(0))
        loss = loss + _PART * PART.absolute(log_soft - sky).mean()
        if num_sharp:
            loss = loss + _HUE * SUN.squared(log_sharp - sky).mean()
        sent = log_sent(irradiance, transfer.indirect)
        loss = loss + _HUE * (WHOLE.squared(sent) + priors.light.squared(sent))
        loss = loss + priors.smooth * (log_soft[near] - log_soft[:, None]).abs().mean()
        loss = loss + _SPREAD * unevenness(amplitudes.soft, hidden)
        loss.backward()
        rate = _RATE * (1 - 0.9 * fraction)
        optimiser.step((rate, rate))
        loss_value = float(neighbour.detach())
    return Amplitudes(soft=log_soft.detach().exp(), sharp=log_sharp.detach().exp()), loss_value


def neutral_start(radiance: Radiance, transfer: Transfer, albedo: float) -> Amplitudes:
    """A grey sky and equally strong suns, scaled to a median albedo."""
    num_soft, num_sharp = transfer.soft.shape[1], transfer.sharp.shape[1]
    sky = transfer.soft.sum(1)
    unit = sky + float(sky.mean()) * 2 * transfer.sharp.sum(1) / max(1, num_sharp)
    wanted = np.pi * radiance.linear.mean(1) / albedo
    scale = float((wanted.median() / unit.median().clamp(min=1e-6)).clamp(min=1e-6))
    soft = torch.full((num_soft, 3), scale)
    sharp = torch.full((num_sharp, 3), 2 * scale * float(sky.mean()) / max(1, num_sharp))
    return Amplitudes(soft=soft, sharp=sharp)


def range_loss(log_albedo: Tensor, chosen: tuple[Tensor, Tensor], priors: Priors) -> Tensor:
    """Penalty for log albedos (U, 3) that no common material has: it fixes the overall scale.

    Without a prior of the level, mean log albedo is drawn to that of common scenes and the
    brightest to common ones; with one, the brightest may only not reflect more than they receive.
    The lowest of the brightest few per cent counts, as above it lie highlights. `chosen` are the
    unclipped samples, and those where the sun is certain: a wall that the mesh turns out of a low
    sun has an albedo of two.
    """
    whole, certain = chosen
    # the quantile, linear between ranks, without sorting what lies below
    brightness = log_albedo.index_select(0, certain).amax(1)
    rank, part = divmod(BRIGHTEST_QUANTILE * (len(brightness) - 1), 1.0)
    above = brightness.topk(len(brightness) - int(rank)).values
    brightest = torch.lerp(above[-1], above[max(len(above) - 2, 0)], part)
    if priors.light.level is not None:
        return 2 * brightest.clamp(min=0)
    high = (brightest - np.log(_BRIGHTEST)).clamp(min=0)
    middle = (log_albedo.index_select(0, whole).mean() - np.log(MEAN_ALBEDO)) ** 2
    return 2 * high + 0.2 * middle.nan_to_num()


def unevenness(soft: Tensor, hidden: Tensor) -> Tensor:
    """How far lobes that few samples see outshine the sky, mean over channels, at least 0.

    The log of the mean square of amplitudes (K, 3), weighted by `hidden` (K,) in 0..1, over the
    square of their mean. A studio's lamps come to 0.9, an outdoor sky without its sun to 0.1.
    """
    square = (hidden @ soft**2) / hidden.sum().clamp(min=1e-6)
    return (square / soft.mean(0) ** 2).clamp(min=1).log().mean()


def lobes_of(
    amplitudes: Amplitudes, axes: NDArray[np.float32], sharpness: NDArray[np.float32]
) -> SphericalGaussians:
    """All lights as one mixture of lobes of radiance, soft ones first, then sharp ones (J,)."""
    soft_axes, soft_sharpness = soft_lobes(len(amplitudes.soft))
    sharp = torch.from_numpy(sharpness).float()
    return SphericalGaussians(
        axis=torch.cat([soft_axes, torch.from_numpy(axes).float().reshape(-1, 3)]),
        sharpness=torch.cat([torch.full((len(soft_axes),), soft_sharpness), sharp]),
        amplitude=torch.cat([amplitudes.soft, amplitude_from_irradiance(sharp, amplitudes.sharp)]),
    )
