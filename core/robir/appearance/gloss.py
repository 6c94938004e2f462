# SPDX-License-Identifier: Apache-2.0
"""Roughness and metal per material, and the specular light that albedo must not keep.

A dielectric reflects with F0 = 0.04 on top of its diffuse light; a metal has no diffuse light and
reflects with its base colour. Both are predicted for every view at several roughnesses, and what
fits the photographs best over a whole cluster of alike samples wins: one sample sees a highlight
in a few views at most, a cluster in many.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.cluster.vq import kmeans2
from torch import Tensor

from robir.appearance.light import soft_lobes
from robir.appearance.problem import Problem
from robir.appearance.solver import Light
from robir.appearance.statistics import HIGH_SHARE, LOW_SHARE, linear_observations
from robir.maths import microfacet
from robir.transport.observe import Observations
from robir.transport.surfels import Surfels

Floats = NDArray[np.float32]

LEVELS = (0.12, 0.2, 0.3, 0.42, 0.56, 0.72, 0.9)
"""Roughnesses that are tried."""

F0 = 0.04
"""Reflectance of dielectrics at normal incidence, Blender's default (IOR 1.45 to 1.5)."""

MATTE = 0.6
"""Roughness given to materials whose views say nothing about it."""

METAL_MARGIN = 0.85
"""A metal must fit this much better than a dielectric: it is the rarer material."""

FLAT_MARGIN = 0.002
"""Relative drop of the cost below which roughness counts as not observed."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Gloss:
    """Specular material of all samples.

    Attributes:
        roughness: (S,) float32, perceptual as in Blender, in [0, 1].
        metallic: (S,) float32, 0 or 1.
        floor: (S, 3) float32, specular radiance left in the mean of the darker views.
        gain: (S, 3) float32, radiance of a metal of base colour 1 in those views.
        table: One dictionary per material for the report.
    """

    roughness: Floats
    metallic: Floats
    floor: Floats
    gain: Floats
    table: tuple[dict[str, float], ...]


@dataclass(frozen=True, slots=True)
class _Rays:
    """Observations of some samples as a flat list.

    Attributes:
        sample: (M,) index into the rows.
        view: (M,) view index.
        view_dir: (M, 3) unit, towards the camera.
        cosine: (M,) normal times view direction.
        mirror: (M,) index of the direction nearest to the mirror direction.
    """

    sample: NDArray[np.int64]
    view: NDArray[np.int64]
    view_dir: Tensor
    cosine: Tensor
    mirror: Tensor


def _rays(
    surfels: Surfels, observations: Observations, rows: NDArray[np.int64], directions: Floats
) -> _Rays:
    sample, view = np.nonzero(observations.weight[rows] > 0)
    position, normal = surfels.position[rows][sample], surfels.normal[rows][sample]
    towards = observations.positions[view] - position
    towards /= np.linalg.norm(towards, axis=1, keepdims=True)
    return _as_rays(sample, view, towards, normal, directions)


def _as_rays(
    sample: NDArray[np.int64],
    view: NDArray[np.int64],
    view_dir: Floats,
    normal: Floats,
    directions: Floats,
) -> _Rays:
    cosine = (view_dir * normal).sum(1).clip(0.02, 1)
    mirror = 2 * cosine[:, None] * normal - view_dir
    nearest = [
        (mirror[start : start + 65536] @ directions.T).argmax(1)
        for start in range(0, len(mirror), 65536)
    ]
    return _Rays(
        sample,
        view,
        torch.from_numpy(view_dir.astype(np.float32)),
        torch.from_numpy(cosine.astype(np.float32)),
        torch.from_numpy(np.concatenate(nearest) if nearest else np.zeros(0, np.int64)),
    )


class _Reflections:
    """Light that reaches samples from around any mirror direction."""

    def __init__(self, problem: Problem, light: Light, rows: NDArray[np.int64]) -> None:
        scene = problem.scene
        visibility = scene.transport.visibility
        directions = torch.from_numpy(visibility.directions)
        axes, sharpness = soft_lobes(len(light.amplitudes.soft))
        sky = torch.exp(sharpness * (directions @ axes.T - 1)) @ light.amplitudes.soft
        normal = torch.from_numpy(scene.transport.surfels.normal[rows])
        bits = np.unpackbits(visibility.bits[rows], axis=1, count=len(directions))
        seen = torch.from_numpy(bits.astype(np.float32))
        cosine = (normal @ directions.T).clamp(min=0)
        blocked = (cosine > 0).float() - seen
        around = (blocked * cosine).sum(1) * (4 * np.pi / len(directions))
        # Light from blocked directions: the mean radiance that the bounce carries.
        bounced = problem.indirect[rows] / around.clamp(min=0.05)[:, None]
        self._directions = directions
        self._incident = [
            seen * sky[:, channel] + blocked * bounced[:, channel, None] for channel in range(3)
        ]
        self._above = (cosine > 0).float()
        self._normal = normal
        self._light = light
        self._sun = scene.sharp_transfer(light.axes, light.sharpness, rows)

    def radiance(self, rays: _Rays, roughness: float) -> Tensor:
        """Specular radiance (M, 2, 3): for F0 = 0.04, and per unit of a metal's base colour."""
        sample = torch.from_numpy(rays.sample)
        cosine, view_dir, mirror = rays.cosine, rays.view_dir, rays.mirror
        # Width of the GGX lobe about the mirror direction at a typical slant.
        alpha = microfacet.ggx_alpha_from_roughness(torch.tensor(roughness))
        sharpness = float(1 / (2 * alpha**2 * 0.75))
        kernel = torch.exp(min(sharpness, 200.0) * (self._directions @ self._directions.T - 1))
        mass = (self._above @ kernel)[sample, mirror].clamp(min=1e-6)
        blurred = torch.stack(
            [(values @ kernel)[sample, mirror] / mass for values in self._incident], 1
        )
        scale, bias = microfacet.environment_brdf(cosine, torch.full_like(cosine, roughness))
        dielectric = blurred * (F0 * scale + bias)[:, None]
        metal = blurred * (scale + bias)[:, None]
        normal = self._normal[sample]
        for index in range(len(self._light.axes)):
            axis = torch.from_numpy(self._light.axes[index]).expand_as(normal)
            arriving = self._sun[sample, index][:, None] * self._light.amplitudes.sharp[index]
            wide = torch.full_like(cosine, max(roughness, 0.12))
            for f0, target in ((F0, dielectric), (1.0, metal)):
                lobe = microfacet.specular_brdf(axis, view_dir, normal, wide, torch.tensor([f0]))
                target += lobe * arriving
        return torch.stack([dielectric, metal], 1)


def specular_towards(
    problem: Problem, light: Light, gloss: Gloss, sample: NDArray[np.int64], view_dir: Floats
) -> tuple[Floats, Floats]:
    """Specular radiance of samples towards any direction.

    Args:
        problem: Scene under a tone curve.
        light: Solved light.
        gloss: Specular material of the samples.
        sample: (N,) sample of each direction.
        view_dir: (N, 3) unit, away from the surface.

    Returns:
        For a dielectric (N, 3), and per unit of base colour of a metal (N, 3).
    """
    result = np.zeros((2, len(sample), 3), np.float32)
    directions = problem.scene.transport.visibility.directions
    levels = gloss.roughness[sample]
    for roughness in np.unique(levels):
        chosen = np.flatnonzero(levels == roughness)
        rows, local = np.unique(sample[chosen], return_inverse=True)
        normal = problem.scene.transport.surfels.normal[sample[chosen]]
        rays = _as_rays(local, np.zeros_like(local), view_dir[chosen], normal, directions)
        both = _Reflections(problem, light, rows).radiance(rays, float(roughness))
        result[:, chosen] = both.numpy().transpose(1, 0, 2)
    return result[0], result[1]


def _dense(values: Tensor, rays: _Rays, shape: tuple[int, int]) -> Tensor:
    """Scatter a flat list (M, C) into (U, V, C), zero where there is no observation."""
    dense = torch.zeros(*shape, values.shape[1])
    dense[rays.sample, rays.view] = values
    return dense


def _low_weights(linear: Tensor, valid: Tensor) -> Tensor:
    """Weights (U, V) of the darker views, as in statistics.diffuse_radiance."""
    count = valid.sum(1)
    rank = linear.sum(2).masked_fill(~valid, float("inf")).argsort(1).argsort(1).float()
    low = (LOW_SHARE * count).floor()[:, None]
    high = (HIGH_SHARE * count).ceil().clamp(min=1)[:, None]
    chosen = (valid & (rank >= torch.minimum(low, high - 1)) & (rank < high)).float()
    return chosen / chosen.sum(1, keepdim=True).clamp(min=1)


def _costs(
    problem: Problem, reflections: _Reflections, rays: _Rays, rows: NDArray[np.int64]
) -> tuple[Tensor, Tensor]:
    """Display error per sample of both models at every level, (U, 2, L), and its weight (U,)."""
    observations = problem.scene.transport.observations
    shape = observations.weight[rows].shape
    display = torch.from_numpy(observations.display[rows].astype(np.float32) / 255)
    linear = problem.curve.linear_from_display(display.reshape(-1, 3)).reshape(display.shape)
    linear = linear.float()
    valid = torch.from_numpy(observations.weight[rows] > 0)
    clipped = torch.from_numpy(observations.clipped[rows])
    costs = []
    for level in LEVELS:
        both = reflections.radiance(rays, level)
        dielectric = _dense(both[:, 0], rays, shape)
        metal = _dense(both[:, 1], rays, shape)
        diffuse = torch.maximum(linear - dielectric, 0.02 * linear)
        base = (diffuse * _low_weights(diffuse, valid)[..., None]).sum(1, keepdim=True)
        ratio = linear / metal.clamp(min=1e-5)
        colour = ratio.masked_fill(~valid[..., None], float("nan")).nanmedian(1).values
        models = (base + dielectric, colour.clamp(0, 1)[:, None] * metal)
        for prediction in models:
            shown = problem.curve.display_from_linear(prediction.reshape(-1, 3))
            error = (shown.reshape(display.shape) - display).abs()
            error = torch.where(clipped & (prediction > linear), torch.zeros_like(error), error)
            error = error.clamp(max=0.15).mean(2) * valid
            costs.append(error.sum(1))
    table = torch.stack(costs, 1).reshape(len(rows), len(LEVELS), 2).transpose(1, 2)
    return table, valid.sum(1).float()


def estimate_gloss(
    problem: Problem, light: Light, num_materials: int, seed: int
) -> tuple[Gloss, Tensor]:
    """Roughness and metal of every sample, by clusters of alike samples.

    Args:
        problem: Scene under the chosen tone curve.
        light: Solved light.
        num_materials: Clusters.
        seed: Of the clustering.

    Returns:
        The gloss and the specular radiance (S, V, 3) of every observation.
    """
    scene = problem.scene
    surfels, observations = scene.transport.surfels, scene.transport.observations
    directions = scene.transport.visibility.directions
    seen = np.flatnonzero(problem.radiance.seen.numpy())
    features = _features(problem, light, seen)
    cluster = _clusters(features, num_materials, seed)
    in_solve = np.isin(seen, scene.rows)
    rows = seen[in_solve]
    reflections = _Reflections(problem, light, rows)
    cost, count = _costs(problem, reflections, _rays(surfels, observations, rows, directions), rows)
    choices = [
        _choose(cost[cluster[in_solve] == index], count[cluster[in_solve] == index])
        for index in range(num_materials)
    ]
    level = np.array([choice[0] for choice in choices])[cluster]
    metal = np.array([choice[1] for choice in choices])[cluster]
    gloss, specular = _apply(problem, light, seen, level, metal)
    table = tuple(
        {
            "roughness": float(choice[0]),
            "metallic": float(choice[1]),
            "share": float((cluster == index).mean()),
        }
        for index, choice in enumerate(choices)
    )
    return Gloss(**{**gloss, "table": table}), specular


def _features(problem: Problem, light: Light, seen: NDArray[np.int64]) -> Floats:
    """Log albedo and how much the views of a sample differ, (N, 4)."""
    observations = problem.scene.transport.observations
    sharp = problem.scene.sharp_transfer(light.axes, light.sharpness, seen)
    irradiance = light.amplitudes.irradiance(problem.transfer(sharp, seen))
    albedo = np.pi * problem.radiance.linear[seen] / irradiance.clamp(min=1e-4)
    linear = linear_observations(observations, problem.curve)[seen].mean(2).clamp(min=1e-4)
    valid = torch.from_numpy(observations.weight[seen] > 0).float()
    mean = (linear.log() * valid).sum(1) / valid.sum(1)
    spread = (((linear.log() - mean[:, None]) ** 2 * valid).sum(1) / valid.sum(1)).sqrt()
    log_albedo = albedo.clamp(0.01, 1.0).log()
    return torch.cat([log_albedo, 1.5 * spread[:, None]], 1).numpy()


def _clusters(features: Floats, count: int, seed: int) -> NDArray[np.int64]:
    """k-means labels (N,)."""
    count = min(count, len(features))
    _, labels = kmeans2(
        features.astype(np.float64), count, minit="++", seed=np.random.default_rng(seed)
    )
    return labels.astype(np.int64)


def _choose(cost: Tensor, count: Tensor) -> tuple[float, float]:
    """Roughness and metal of one cluster from its samples' costs."""
    if len(cost) < 5:
        return MATTE, 0.0
    pooled = cost.sum(0) / count.sum()
    metallic = float(pooled[1].min()) < METAL_MARGIN * float(pooled[0].min())
    curve = pooled[1 if metallic else 0].numpy()
    best = int(curve.argmin())
    if not metallic and curve.max() - curve.min() < FLAT_MARGIN * curve.min():
        return MATTE, 0.0
    roughness = LEVELS[best]
    if 0 < best < len(LEVELS) - 1:
        left, middle, right = curve[best - 1 : best + 2]
        shift = 0.5 * (left - right) / max(left - 2 * middle + right, 1e-9)
        step = LEVELS[best + 1] - LEVELS[best] if shift > 0 else LEVELS[best] - LEVELS[best - 1]
        roughness += float(np.clip(shift, -0.5, 0.5)) * step
    return float(roughness), float(metallic)


def _apply(
    problem: Problem,
    light: Light,
    seen: NDArray[np.int64],
    level: NDArray[np.float64],
    metal: NDArray[np.float64],
) -> tuple[dict[str, Floats], Tensor]:
    """Specular radiance of all seen samples with their own roughness."""
    scene = problem.scene
    observations, surfels = scene.transport.observations, scene.transport.surfels
    num = len(surfels)
    specular = torch.zeros(num, observations.weight.shape[1], 3)
    floor, gain = np.zeros((num, 3), np.float32), np.ones((num, 3), np.float32)
    linear = linear_observations(observations, problem.curve)
    for roughness in np.unique(level):
        rows = seen[level == roughness]
        reflections = _Reflections(problem, light, rows)
        rays = _rays(surfels, observations, rows, scene.transport.visibility.directions)
        both = reflections.radiance(rays, float(roughness))
        shape = observations.weight[rows].shape
        dielectric, whole = (_dense(both[:, index], rays, shape) for index in (0, 1))
        valid = torch.from_numpy(observations.weight[rows] > 0)
        low = _low_weights(torch.maximum(linear[rows] - dielectric, 0.02 * linear[rows]), valid)
        specular[rows] = dielectric
        floor[rows] = (dielectric * low[..., None]).sum(1).numpy()
        gain[rows] = (whole * low[..., None]).sum(1).numpy()
    full_level = np.full(num, MATTE, np.float32)
    full_level[seen] = level
    full_metal = np.zeros(num, np.float32)
    full_metal[seen] = metal
    specular[full_metal > 0.5] = 0
    return (
        {"roughness": full_level, "metallic": full_metal, "floor": floor, "gain": gain},
        specular,
    )
