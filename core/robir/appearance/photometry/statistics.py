# SPDX-License-Identifier: Apache-2.0
"""One radiance per surface sample, and pairs of samples that may share an albedo."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from torch import Tensor

from robir.appearance.photometry.exposure import Gains, decoded
from robir.maths.daylight import SUN, HueSpread
from robir.maths.tone_curve import AbstractToneCurve
from robir.transport.observe import Observations
from robir.transport.surfels import Surfels
from robir.workers import num_workers

# rank of brightness from which a sample's views are averaged: pixels darkened by an outline lie
# below
_LOW_SHARE = 0.1
_HIGH_SHARE = 0.5  # rank up to which they are: highlights lie above
_CLIPPED_SHARE = 0.3  # weight of its clipped views from which a sample is clipped
# how far apart a sample in shadow and its lit partner may lie. Under a low sun shadows are longer
# than what casts them (unit frame)
_SHADOW_REACH = 0.8
_SHADOW_NORMAL = 0.6  # what a difference of one unit of normal counts in that distance (unit frame)
_LEAST_SHADOW_SAMPLES = 20  # in the shadow and lit, from which a shadow is compared
_SHADOW_PARTNERS = 12  # lit partners of a sample in shadow
# of how many lit samples one may be its partner, at least. The nearest all hug the shadow's edge,
# where photographs blur it and the mesh displaces it; of those far away more are of another
# material.
_SHADOW_PARTS = 4
_LARGEST_PART = 1250  # of how many samples, lit or not, a part of these consists at most
# width of the kernel that finds the commonest step across shadows: more than noise, less than the
# difference between the materials of a scene (log units)
STEP_WIDTH = 0.15
_STEP_PAIRS = 4000  # pairs that tell a step
_STEP_STARTS = 400  # those of them from which it is searched
_STEP_ROUNDS = 30  # rounds of the search


@dataclass(frozen=True, slots=True, kw_only=True)
class Radiance:
    """Exitant radiance of the samples without highlights, under one tone curve."""

    linear: Tensor  # (S, 3) float32, linear Rec.709, > 0 where seen
    clipped: Tensor  # (S, 3) bool; the true value is at least `linear`
    seen: Tensor  # (S,) bool; at least two views show the sample


def linear_observations(
    observations: Observations, curve: AbstractToneCurve, gains: Gains, normals: NDArray[np.float32]
) -> Tensor:
    """Radiance (N, V, 3) float32, linear Rec.709, at the common exposure, under a tone curve.

    Anything where a view does not show the sample; normals (N, 3) in the unit frame.
    """
    return gains.undone(decoded(observations, curve), observations, normals)


def darker_view_weights(linear: Tensor, valid: Tensor) -> Tensor:
    """Weights (N, V) of the views between two ranks of each sample's brightness; rows sum to 1.

    Of radiance (N, V, 3) and views that show the sample (N, V) bool; 0 where none does.
    """
    count = valid.sum(1)
    rank = linear.sum(2).masked_fill(~valid, float("inf")).argsort(1).argsort(1).float()
    low = (_LOW_SHARE * count).floor()[:, None]
    high = (_HIGH_SHARE * count).ceil().clamp(min=1)[:, None]
    chosen = (valid & (rank >= torch.minimum(low, high - 1)) & (rank < high)).float()
    return chosen / chosen.sum(1, keepdim=True).clamp(min=1)


def texture_weights(
    seen: tuple[NDArray[np.float32], NDArray[np.float32]], position: NDArray[np.float32]
) -> Tensor:
    """What each view counts (N, V) in the radiance that textures are made from; rows sum to 1.

    By the pixels on a patch about points (N, 3): the mean of all views repeats photographs best.
    `seen` is weights (N, V) of the observations, and camera centres (V, 3).
    """
    weight, cameras = seen
    apart = cameras[None] - position[:, None]
    pixels = torch.from_numpy(weight / np.einsum("nvd,nvd->nv", apart, apart))
    return pixels / pixels.sum(1, keepdim=True).clamp(min=1e-12)


def diffuse_radiance(observations: Observations, linear: Tensor) -> Radiance:
    """Robust low mean over the views of radiance (N, V, 3): highlights drop out, noise averages."""
    valid = torch.from_numpy(observations.weight > 0)
    share = darker_view_weights(linear, valid)
    return weighted_radiance(observations, linear, share)


def weighted_radiance(observations: Observations, linear: Tensor, share: Tensor) -> Radiance:
    """Mean over the views, each sample's counting (N, V) as told; else as `diffuse_radiance`."""
    mean = (linear * share[..., None]).sum(1)
    top = torch.from_numpy(observations.clipped) & (share > 0)[..., None]
    clipped = (top.float() * share[..., None]).sum(1) > _CLIPPED_SHARE
    seen = (observations.weight > 0).sum(1) >= 2
    return Radiance(linear=mean.clamp(min=1e-5), clipped=clipped, seen=torch.from_numpy(seen))


def display_mean(radiance: Tensor, weight: Tensor, curve: AbstractToneCurve) -> Tensor:
    """Radiance (N, 3) whose display colour is the weighted mean over views (N, V, 3).

    Of all that are the same from everywhere it repeats the photographs best in display codes. Rows
    of zero `weight` (N, V) give 0.
    """
    known = weight > 0
    shown = torch.zeros(radiance.shape)
    shown[known] = curve.display_from_linear(radiance[known]).float()
    share = weight / weight.sum(1, keepdim=True).clamp(min=1e-9)
    mean = torch.einsum("nvc,nv->nc", shown, share)
    return curve.linear_from_display(mean.clamp(0, 1)).float()


@dataclass(frozen=True, slots=True, kw_only=True)
class Pairs:
    """Pairs of samples whose albedos are compared."""

    first: Tensor  # (P,) int64 indices
    second: Tensor  # (P,) int64 indices
    weight: Tensor  # (P,) float32, sums to 1

    def of(self, chosen: Tensor) -> Pairs:
        """Some of the pairs, bool (P,) or indices."""
        part = Pairs(
            first=self.first[chosen], second=self.second[chosen], weight=self.weight[chosen]
        )
        return part.weighted(torch.ones_like(part.weight))

    def unclipped(self, clipped: Tensor) -> Tensor:
        """Which of the pairs (P,) have no end that is clipped, (U, 3), in any channel."""
        whole = ~clipped.any(1)
        return whole[self.first] & whole[self.second]

    def weighted(self, factor: Tensor) -> Pairs:
        """The same pairs, the weight of each times a factor (P,)."""
        weight = self.weight * factor
        return replace(self, weight=weight / weight.sum().clamp(min=1e-9))

    def facing_alike(self, normal: NDArray[np.float32], cosine: float) -> Pairs:
        """The pairs between whose normals, of (U, 3), the cosine is greater than a given one."""
        facing = torch.from_numpy(normal)
        return self.of((facing[self.first] * facing[self.second]).sum(1) > cosine)

    @classmethod
    def joined(cls, parts: list[Pairs]) -> Pairs:
        """All pairs of some lists, each list counting by its length."""
        count = max(1, sum(len(part.first) for part in parts))
        none = torch.zeros(0, dtype=torch.int64)
        return cls(
            first=torch.cat([none, *(part.first for part in parts)]),
            second=torch.cat([none, *(part.second for part in parts)]),
            weight=torch.cat(
                [torch.zeros(0), *(part.weight * (len(part.first) / count) for part in parts)]
            ),
        )

    def common_step(self, log_albedo: Tensor) -> Tensor:
        """The commonest difference (3,) of log albedo (U, 3) between first and second samples.

        Across a shadow it is the step that a wrong light leaves: pairs of one material share it,
        and other differences are rarer (a distribution's correlation with itself is greatest at no
        shift). Of two that are as common it is the one by which sun and sky may differ. By mean
        shift with a kernel of `STEP_WIDTH`; zeros without pairs.
        """
        if not len(self.first):
            return torch.zeros(3)
        some = torch.linspace(0, len(self.first) - 1, _STEP_PAIRS).long().unique()
        apart = log_albedo[self.first[some]] - log_albedo[self.second[some]]
        weight = self.weight[some]
        starts = apart[:: max(1, len(apart) // _STEP_STARTS)]
        votes = torch.exp(-(torch.cdist(starts, apart) ** 2) / (2 * STEP_WIDTH**2)) @ weight
        # seen through that kernel: what a light lacks is light, what two materials differ by is not
        hue = HueSpread(blue=SUN.blue, green=float(np.hypot(SUN.green, STEP_WIDTH)))
        step = starts[(votes * torch.exp(-0.5 * hue.squared(starts))).argmax()]
        for _ in range(_STEP_ROUNDS):
            near = weight * torch.exp(-((apart - step) ** 2).sum(1) / (2 * STEP_WIDTH**2))
            step = near @ apart / near.sum()
        return step

    def likeness(
        self, log_albedo: Tensor, hue: float, brightness: float, step: Tensor | None = None
    ) -> Tensor:
        """How alike the samples of each pair are but for a step, 0..1, (P,).

        Of log albedo (U, 3). `hue` and `brightness` are the differences, log units, at which it is
        exp(-1/2); `step` (3,) is that between the samples of a pair of one material, none if None.
        """
        apart = log_albedo[self.first] - log_albedo[self.second]
        if step is not None:
            apart = apart - step
        grey = apart.mean(1)
        squared = ((apart - grey[:, None]) ** 2).sum(1) / hue**2 + (grey / brightness) ** 2
        return torch.exp(-0.5 * squared)


def neighbour_pairs(
    surfels: Surfels,
    usable: NDArray[np.int64],
    reaches: tuple[float, ...],
    per_reach: int,
    rng: np.random.Generator,
) -> Pairs:
    """Random neighbours among `usable` samples (U,), `per_reach` at each distance, unit frame."""
    position = surfels.position[usable].astype(np.float64)
    count = len(position)
    tree = cKDTree(position)
    first, second = [], []
    for reach in reaches:
        for _ in range(per_reach):
            direction = rng.normal(size=(count, 3))
            normal = surfels.normal[usable]
            # Step mostly within the tangent plane: that is where neighbours are.
            direction -= 0.7 * (direction * normal).sum(1, keepdims=True) * normal
            direction /= np.linalg.norm(direction, axis=1, keepdims=True)
            length = reach * rng.uniform(0.5, 1.0, (count, 1))
            distance, other = tree.query(position + length * direction, k=1, workers=num_workers())
            good = (distance < 0.5 * reach + surfels.spacing) & (other != np.arange(count))
            first.append(np.flatnonzero(good))
            second.append(other[good])
    left, right = np.concatenate(first), np.concatenate(second)
    weight = np.full(len(left), 1 / max(1, len(left)), np.float32)
    return Pairs(
        first=torch.from_numpy(left),
        second=torch.from_numpy(right),
        weight=torch.from_numpy(weight),
    )


def shadow_pairs(
    position: NDArray[np.float32],
    normal: NDArray[np.float32],
    lit: NDArray[np.bool_],
    dark: NDArray[np.bool_],
) -> Pairs:
    """Pairs across a sun's shadow: samples wholly `dark` (U,) with near ones wholly `lit` (U,).

    Neighbours at fixed distances hold few such pairs, which say how strong the sun is. Partners
    face alike, by positions and normals (U, 3), so that only visibility differs.
    """
    points = np.concatenate([position, _SHADOW_NORMAL * normal], axis=1)
    lit_rows, dark_rows = np.flatnonzero(lit), np.flatnonzero(dark)
    first, second = [np.zeros(0, np.int64)], [np.zeros(0, np.int64)]
    if min(len(lit_rows), len(dark_rows)) >= _LEAST_SHADOW_SAMPLES:
        # each part of those in shadow has its own part of the lit ones
        parts = max(_SHADOW_PARTS, round(len(position) / _LARGEST_PART))
        parts = max(1, min(parts, len(lit_rows) // _SHADOW_PARTNERS))
        for part in range(parts):
            own, partners = dark_rows[part::parts], lit_rows[part::parts]
            count = min(_SHADOW_PARTNERS, len(partners))
            distance, index = cKDTree(points[partners]).query(
                points[own], k=count, workers=num_workers()
            )
            near = distance < _SHADOW_REACH
            first.append(np.repeat(own, count)[near.ravel()])
            second.append(partners[index[near]])
    left, right = np.concatenate(first), np.concatenate(second)
    weight = torch.full((len(left),), 1 / max(1, len(left)))
    return Pairs(first=torch.from_numpy(left), second=torch.from_numpy(right), weight=weight)
