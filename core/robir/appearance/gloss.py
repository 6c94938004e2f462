# SPDX-License-Identifier: Apache-2.0
"""Roughness and metal, and the specular light that albedo must not keep.

A dielectric reflects with F0 = 0.04 on top of its diffuse light; a metal has no diffuse light and
reflects with its base colour. Both are predicted for every view at several roughnesses. What is
metal is judged by the neighbourhood of each sample: its views differ more than any dielectric's
may. Roughness is judged over a whole cluster of alike samples: one sample sees a highlight in a few
views at most, a cluster in many.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.cluster.vq import kmeans2
from scipy.spatial import cKDTree
from torch import Tensor

from robir.appearance.metal import metal_parts, metal_samples
from robir.appearance.problem import Problem
from robir.appearance.reflections import (
    Reflections,
    ViewRays,
    as_rays,
    reflected_share,
    view_rays,
)
from robir.appearance.solver import Light
from robir.appearance.statistics import darker_view_weights, sharpest_views

Floats = NDArray[np.float32]

LEVELS = (0.12, 0.2, 0.3, 0.42, 0.56, 0.72, 0.9)
"""Roughnesses that are tried."""

TILTS = ((0.0, 0.0), *((0.12 * np.cos(a), 0.12 * np.sin(a)) for a in np.arange(6) * np.pi / 3))
"""Tilts of the normal a highlight may need, as tangents: 7 degrees, about the mesh's error."""

MATTE = 0.5
"""Roughness given to materials whose views say nothing about it."""

ALIKE_NORMAL = 0.06
"""Distance, unit frame, that half the difference of opposite normals counts as."""

ROUGHEST_METAL = 5
"""Levels at which metal is tried: a rougher metal looks like a dielectric of another shade."""

FIRST_SHOWN = 2
"""First level whose highlight is wide enough for a few dozen views to show it."""

SHARP_LEAD = 0.9
"""Cost of a sharper level against the best of the rough ones at which it is believed."""

MATTE_LEAD = 0.4
"""Cost without any highlight against the best with one at which a material is as rough as can be:
a highlight too sharp for any view to show fits a matte surface nearly as well as none."""

MIN_HIGHLIGHTS = 100
"""Views near a sun's mirror direction that a material must have for its roughness to be judged."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Gloss:
    """Specular material of all samples.

    Attributes:
        roughness: (S,) float32, perceptual as in Blender, in [0, 1].
        metallic: (S,) float32, 0 or 1.
        metal: (S, 3) float32, base colour of the nearest metal part, linear Rec.709; 0 where the
            scene has none.
        floor: (S, 3) float32, specular radiance left in the mean of the darker views.
        kept: (S, 1) float32, share of the diffuse light that the specular layer lets through there.
        table: One dictionary per material for the report.
    """

    roughness: Floats
    metallic: Floats
    metal: Floats
    floor: Floats
    kept: Floats
    table: tuple[dict[str, float], ...]


def specular_towards(
    problem: Problem, light: Light, gloss: Gloss, sample: NDArray[np.int64], view_dir: Floats
) -> tuple[Floats, Floats, Floats]:
    """Specular radiance of samples towards any direction.

    Args:
        problem: Scene under a tone curve.
        light: Solved light.
        gloss: Specular material of the samples.
        sample: (N,) sample of each direction.
        view_dir: (N, 3) unit, away from the surface.

    Returns:
        For a dielectric (N, 3), per unit of base colour of a metal (N, 3), and the share (N, 1) of
        diffuse light that the dielectric's specular layer lets through.
    """
    result = np.zeros((2, len(sample), 3), np.float32)
    kept = np.ones((len(sample), 1), np.float32)
    directions = problem.scene.transport.visibility.directions
    levels = gloss.roughness[sample]
    for roughness in np.unique(levels):
        chosen = np.flatnonzero(levels == roughness)
        rows, local = np.unique(sample[chosen], return_inverse=True)
        normal = problem.scene.transport.surfels.normal[sample[chosen]]
        rays = as_rays(local, np.zeros_like(local), view_dir[chosen], normal, directions)
        both = Reflections(problem, light, rows).radiance(rays, float(roughness))
        result[:, chosen] = both.numpy().transpose(1, 0, 2)
        kept[chosen] = 1 - reflected_share(rays, float(roughness))[:, None].numpy()
    return result[0], result[1], kept


def _dense(values: Tensor, rays: ViewRays, shape: tuple[int, int]) -> Tensor:
    """Scatter a flat list (M, C) into (U, V, C), zero where there is no observation."""
    dense = torch.zeros(*shape, values.shape[1])
    dense[rays.sample, rays.view] = values
    return dense


@dataclass(frozen=True, slots=True)
class _Costs:
    """Display errors of some samples at every level.

    Attributes:
        highlight: (U, L) error of a dielectric in views near a sun's mirror direction.
        plain: (U,) the same without any highlight.
        num_highlight: (U,) number of such views.
        whole: (U, 2, L) error of a dielectric and of a metal in all views.
        num_whole: (U,) number of views.
    """

    highlight: Tensor
    plain: Tensor
    num_highlight: Tensor
    whole: Tensor
    num_whole: Tensor

    def pooled(self, chosen: NDArray[np.bool_]) -> _Costs:
        """Sums over the chosen samples."""
        rows = torch.from_numpy(chosen)
        return _Costs(
            self.highlight[rows].sum(0),
            self.plain[rows].sum(),
            self.num_highlight[rows].sum(),
            self.whole[rows].sum(0),
            self.num_whole[rows].sum(),
        )


def _costs(
    problem: Problem, reflections: Reflections, rays: ViewRays, rows: NDArray[np.int64]
) -> tuple[_Costs, Tensor]:
    """Errors of both models at every level, and the radiance (M, 3) that every ray sees.

    Only views near a sun's mirror direction speak about the roughness of a dielectric; elsewhere a
    rougher surface merely hides errors of the sky and of the mesh, and would always win.
    """
    observations = problem.scene.transport.observations
    shape = (len(rows), observations.weight.shape[1])
    sample, view = torch.from_numpy(rays.sample), torch.from_numpy(rays.view)
    display = torch.from_numpy(observations.display[rows].astype(np.float32) / 255)[sample, view]
    linear = problem.linear[rows][sample, view]
    clipped = torch.from_numpy(observations.clipped[rows])[sample, view]
    valid = torch.from_numpy(observations.weight[rows] > 0)
    gain = problem.gains.of(observations.views)[view]
    gain = problem.gains.dimmed(gain, observations.off_axis[rows][sample.numpy(), view.numpy()])

    def error(prediction: Tensor, of: Tensor) -> Tensor:
        """Display error of predictions for the rays of these numbers."""
        shown = problem.curve.display_from_linear(gain.index_select(0, of) * prediction)
        shown = (shown - display.index_select(0, of)).abs()
        shown = shown.masked_fill(
            clipped.index_select(0, of) & (prediction > linear.index_select(0, of)), 0
        )
        return shown.clamp(max=0.15).mean(1)

    def summed(values: Tensor, of: Tensor) -> Tensor:
        """Sums (U,) over the samples of the rays of these numbers."""
        return torch.zeros(len(rows)).index_add_(0, sample.index_select(0, of), values)

    every = torch.arange(len(sample))
    # only what is near a highlight tells its tilt: the costliest part, for few of the rays
    near = reflections.near_highlight(rays).nonzero()[:, 0]
    near_rays = rays.chosen(near)
    highlight = torch.full((len(rows), len(LEVELS)), float("inf"))
    whole = torch.zeros(len(rows), 2, len(LEVELS))
    even = reflections.from_sky(rays, MATTE)[:, 0]
    for index, level in enumerate(LEVELS):
        suns = reflections.from_suns(rays, level, torch.zeros(2))
        both = reflections.from_sky(rays, level) + suns
        through = 1 - reflected_share(rays, level)[:, None]
        below = torch.maximum(linear - both[:, 0], 0.02 * linear) / through
        base = _low_mean(below, rays, valid)[sample] * through
        ratio = _dense(linear / both[:, 1].clamp(min=1e-5), rays, shape)
        colour = ratio.masked_fill(~valid[..., None], float("nan")).nanmedian(1).values
        whole[:, 0, index] = summed(error(base + both[:, 0], every), every)
        metal = colour.clamp(0, 1)[sample] * both[:, 1]
        whole[:, 1, index] = summed(error(metal, every), every)
        below = torch.maximum(linear - (even + suns[:, 0]), 0.02 * linear) / through
        base = (_low_mean(below, rays, valid)[sample] * through + even).index_select(0, near)
        for tilt in TILTS:
            sun = reflections.from_suns(near_rays, level, torch.tensor(tilt))[:, 0]
            total = summed(error(base + sun, near), near)
            highlight[:, index] = torch.minimum(highlight[:, index], total)
    plain = summed(error(_low_mean(linear, rays, valid)[sample[near]], near), near)
    counts = summed(torch.ones(len(near)), near)
    return _Costs(highlight, plain, counts, whole, valid.sum(1).float()), linear


def _low_mean(linear: Tensor, rays: ViewRays, valid: Tensor) -> Tensor:
    """Mean (U, 3) over each sample's darker views of a flat list (M, 3)."""
    dense = _dense(linear, rays, (valid.shape[0], valid.shape[1]))
    return (dense * darker_view_weights(dense, valid)[..., None]).sum(1)


def estimate_gloss(
    problem: Problem, light: Light, num_materials: int, seed: int
) -> tuple[Gloss, Tensor]:
    """Roughness and metal of every sample.

    Args:
        problem: Scene under the chosen tone curve.
        light: Solved light.
        num_materials: Clusters of dielectrics.
        seed: Of the clustering.

    Returns:
        The gloss and the diffuse radiance (S, V, 3) of every observation.
    """
    scene = problem.scene
    surfels, observations = scene.transport.surfels, scene.transport.observations
    directions = scene.transport.visibility.directions
    seen = np.flatnonzero(problem.radiance.seen.numpy())
    in_solve = np.isin(seen, scene.rows)
    rows = seen[in_solve]
    reflections = Reflections(problem, light, rows)
    rays = view_rays(surfels, observations, rows, directions)
    costs, linear = _costs(problem, reflections, rays, rows)
    mean = (costs.whole / costs.num_whole.clamp(min=1)[:, None, None]).numpy()
    metal_errors = mean[:, 1, :ROUGHEST_METAL]
    points = np.concatenate([surfels.position, ALIKE_NORMAL * surfels.normal], axis=1)
    metals = metal_samples(mean[:, 0], metal_errors, points[rows])
    place = surfels.position[rows], surfels.spacing * float(np.sqrt(len(surfels) / len(rows)))
    parts = metal_parts(metals, place, (reflections, rays, linear), metal_errors, LEVELS)
    is_metal = parts.part >= 0
    # the samples that took part speak for their neighbours
    part = parts.part[cKDTree(points[rows]).query(points[seen])[1]]
    cluster = _clusters(_features(problem, light, seen), num_materials, seed)
    choices = [
        _roughness(costs.pooled((cluster[in_solve] == index) & ~is_metal))
        for index in range(num_materials)
    ]
    level = np.array(choices)[cluster]
    level[part >= 0] = parts.roughness[part[part >= 0]]
    gloss, diffuse = _apply(problem, light, seen, level, (part >= 0).astype(np.float64))
    metal = np.zeros((len(surfels), 3), np.float32)
    if is_metal.any():
        nearest = cKDTree(surfels.position[rows[is_metal]]).query(surfels.position)[1]
        metal = parts.base[parts.part[is_metal][nearest]]
    kinds = [(choice, 0.0, (cluster == k) & (part < 0)) for k, choice in enumerate(choices)]
    kinds += [(float(value), 1.0, part == k) for k, value in enumerate(parts.roughness)]
    table = tuple(
        {"roughness": roughness, "metallic": metallic, "share": float(chosen.mean())}
        for roughness, metallic, chosen in kinds
    )
    return Gloss(**{**gloss, "metal": metal, "table": table}), diffuse


def _features(problem: Problem, light: Light, seen: NDArray[np.int64]) -> Floats:
    """Log albedo and how much the views of a sample differ, (N, 4)."""
    observations = problem.scene.transport.observations
    sharp = problem.scene.sharp_transfer(light.axes, light.sharpness, seen)
    irradiance = light.amplitudes.irradiance(problem.transfer(sharp, seen))
    albedo = np.pi * problem.radiance.linear[seen] / irradiance.clamp(min=1e-4)
    linear = problem.linear[seen].mean(2).clamp(min=1e-4)
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


def _roughness(pooled: _Costs) -> float:
    """Roughness of a cluster of dielectrics from its pooled costs."""
    if float(pooled.num_highlight) < MIN_HIGHLIGHTS:
        return MATTE
    if pooled.plain < MATTE_LEAD * pooled.highlight.min():
        return LEVELS[-1]
    return lowest_cost(pooled.highlight.numpy())


def lowest_cost(curve: Floats) -> float:
    """Roughness at the minimum of a parabola through the lowest level and its neighbours.

    A highlight too sharp for any view to show and one too wide to stand out predict the same
    photographs; unless the sharp one does much better it is not believed.

    Args:
        curve: (L,) costs of the levels.
    """
    best = int(curve.argmin())
    if best < FIRST_SHOWN and curve[best] > SHARP_LEAD * curve[FIRST_SHOWN + 1 :].min():
        best = FIRST_SHOWN + int(curve[FIRST_SHOWN:-1].argmin())
    if best in (0, len(curve) - 1):
        return LEVELS[best]
    around = slice(best - 1, best + 2)
    square, slope, _ = np.polyfit(LEVELS[around], curve[around].astype(np.float64), 2)
    vertex = -slope / (2 * square) if square > 0 else LEVELS[best]
    return float(np.clip(vertex, LEVELS[best - 1], LEVELS[best + 1]))


def _apply(
    problem: Problem,
    light: Light,
    seen: NDArray[np.int64],
    level: NDArray[np.float64],
    metal: NDArray[np.float64],
) -> tuple[dict[str, Floats], Tensor]:
    """Diffuse radiance of all observations, each sample with its own roughness."""
    scene = problem.scene
    observations, surfels = scene.transport.observations, scene.transport.surfels
    num = len(surfels)
    diffuse = problem.linear.clone()
    floor = np.zeros((num, 3), np.float32)
    kept = np.ones((num, 1), np.float32)
    full_level, full_metal = np.full(num, MATTE, np.float32), np.zeros(num, np.float32)
    full_level[seen], full_metal[seen] = level, metal
    for roughness in np.unique(level):
        rows = seen[level == roughness]
        reflections = Reflections(problem, light, rows)
        rays = view_rays(surfels, observations, rows, scene.transport.visibility.directions)
        both = reflections.radiance(rays, float(roughness))
        shape = (len(rows), observations.weight.shape[1])
        dielectric = _dense(both[:, 0], rays, shape)
        through = 1 - _dense(reflected_share(rays, float(roughness))[:, None], rays, shape)
        linear = diffuse[rows]
        below = torch.maximum(linear - dielectric, 0.02 * linear) / through
        # the views that the textures are read from, see texture.py
        sharpest = torch.from_numpy(sharpest_views(observations.weight[rows]) > 0)
        low = darker_view_weights(linear, sharpest)[..., None]
        floor[rows] = (dielectric * low).sum(1).numpy()
        kept[rows] = (through * low).sum(1).numpy()
        is_metal = torch.from_numpy(full_metal[rows] > 0.5)[:, None, None]
        diffuse[rows] = torch.where(is_metal, linear, below)
    return (
        {
            "roughness": full_level,
            "metallic": full_metal,
            "floor": floor,
            "kept": kept,
        },
        diffuse,
    )
