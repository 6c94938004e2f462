# SPDX-License-Identifier: Apache-2.0
"""Roughness and metal, and the specular light that albedo must not keep.

A dielectric reflects with F0 = 0.04 on top of its diffuse light; a metal has none and reflects with
its base colour. Both are predicted for every view at several roughnesses. Metal is classified by
neighbourhoods, roughness by patches alike in albedo and place, as one sample sees a highlight in
few views (roughness.py).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from torch import Tensor

from robir.appearance.light.problem import Problem
from robir.appearance.light.solver import Light
from robir.appearance.material.highlights import LEVELS, UNKNOWN, Highlights
from robir.appearance.material.metal import clusters, find_metal, means, near, tested_parts
from robir.appearance.material.observed import (
    LEAST_DIFFUSE,
    ObservedRays,
    dense,
    diffuse_below,
    looked_at,
    low_mean,
)
from robir.appearance.material.reflections import (
    Reflections,
    ViewRays,
    as_rays,
    reflected_share,
    view_rays,
)
from robir.appearance.material.roughness import RoughnessPatches, choose_roughness
from robir.appearance.material.trial import MaterialTrial
from robir.appearance.photometry.statistics import texture_weights
from robir.jobs.context import Choice
from robir.workers import side_by_side

Floats = NDArray[np.float32]
Reals = NDArray[np.floating[Any]]

# distance, unit frame, that half the difference of opposite normals counts as between samples that
# are judged together
_NORMAL_SCALE = 0.06
# the same of a difference of one in the logarithm of albedo, as of paint: a small part of metal is
# judged with itself, not with the paint about it
_ALBEDO_SCALE = 0.05
_SPREAD_SCALE = 1.5  # difference of log albedo that one of the deviation of views counts as
# roughness of the sky's reflection beside sharper highlights: what a sharper one would show of the
# sky and of the surroundings, their errors and the mesh's displace
SHARPEST_SKY = 0.5
_LEVELS_TOGETHER = 4  # roughnesses tried at a time at most: each holds all observations


@dataclass(frozen=True, slots=True, kw_only=True)
class SpecularMaterial:
    """Specular material of all samples."""

    roughness: Floats  # (S,) float32, perceptual as in Blender, in [0, 1]
    metallic: Floats  # (S,) float32, 0 or 1
    # (S, 3) float32, base colour of the nearest metal part, linear Rec.709; 0 where the scene has
    # none
    metal: Floats
    floor: Floats  # (S, 3) float32, specular radiance in the mean of the views
    # (S, 1) float32, share of the diffuse light that the specular layer lets through there
    kept: Floats
    has_highlights: bool  # whether dielectrics have a specular layer
    table: tuple[dict[str, float], ...]  # one dictionary per dielectric patch and per metal part
    choices: tuple[Choice, ...]  # what was chosen against what, for the report

    def solved_by(self, rows: NDArray[np.int64], least_share: float) -> NDArray[np.int64]:
        """Of some samples those that the light is solved by: dielectrics if there are enough."""
        dielectric = rows[self.is_dielectric[rows]]
        return dielectric if len(dielectric) >= least_share * len(rows) else rows

    @property
    def is_dielectric(self) -> NDArray[np.bool_]:
        """(S,) bool."""
        return self.metallic < 0.5


def specular_towards(
    problem: Problem,
    light: Light,
    specular: SpecularMaterial,
    sample: NDArray[np.int64],
    view_dir: Floats,
) -> tuple[Floats, Floats, Floats]:
    """Specular radiance of samples (N,) towards directions (N, 3), unit, away from the surface.

    For a dielectric (N, 3), per unit of base colour of a metal (N, 3), and the share (N, 1) of
    diffuse light that the dielectric's specular layer lets through.
    """
    result = np.zeros((2, len(sample), 3), np.float32)
    kept = np.ones((len(sample), 1), np.float32)
    directions = problem.scene.transport.visibility.directions
    order = np.argsort(sample, kind="stable")
    levels = specular.roughness[sample[order]]
    for roughness in np.unique(levels):
        chosen = order[levels == roughness]
        rows, local = np.unique(sample[chosen], return_inverse=True)
        normal = problem.scene.transport.surfels.normal[sample[chosen]]
        rays = as_rays(local, np.zeros_like(local), view_dir[chosen], normal, directions)
        reflections = Reflections(problem, light, rows)
        both = reflections.radiance(rays, float(roughness))
        result[:, chosen] = both.numpy().transpose(1, 0, 2)
        kept[chosen] = 1 - reflected_share(rays, float(roughness))[:, None].numpy()
    if not specular.has_highlights:
        result[0], kept[:] = 0, 1
    return result[0], result[1], kept


def _costs(looked: tuple[Reflections, ViewRays, ObservedRays, Tensor]) -> tuple[Highlights, Floats]:
    """Errors of a dielectric near highlights and elsewhere, and their mean (U, L) over views."""
    # elsewhere a rougher surface merely hides errors of sky and mesh: there the sky is reflected no
    # sharper than `SHARPEST_SKY`
    reflections, rays, seen, valid = looked
    sample = rays.sample
    near = reflections.near_highlight(rays)
    near_rays, near_seen = rays.of(near), seen.of(near)
    others = torch.ones(len(sample), dtype=torch.bool).index_fill_(0, near, value=False)

    def summed(values: Tensor, rays: ViewRays) -> Tensor:
        return torch.zeros(len(valid)).index_add_(0, torch.from_numpy(rays.sample), values)

    def below(specular: Tensor, through: Tensor) -> Tensor:
        return diffuse_below(seen, specular, through, (rays, valid))

    blurred = reflections.from_sky(rays, SHARPEST_SKY)[:, 0]

    def at(level: float) -> tuple[Tensor, ...]:
        through = 1 - reflected_share(rays, level)[:, None]
        sky, sun = reflections.from_sky(rays, level), reflections.from_suns(rays, level)
        lit, even = (sky + sun)[:, 0], sky[:, 0]
        base = below(lit, through)
        excess = seen.excess(base + lit)
        dielectric = summed(seen.counted(excess, base + lit), rays)
        noise = excess[others].mean(1)
        if level < SHARPEST_SKY:
            base, even = below(blurred + sun[:, 0], through), blurred
        soft = (base + even)[near]
        peaks = near_seen.excess(soft).mean(1)
        predicted = peaks - near_seen.excess(soft + sun[near, 0]).mean(1)
        highlight = torch.full((len(valid),), float("inf"))
        for tilt in reflections.tilts:
            shone = reflections.from_suns(near_rays, level, tilt)[:, 0]
            total = summed(near_seen.error(soft + shone), near_rays)
            highlight = torch.minimum(highlight, total)
        return highlight, dielectric, noise, peaks, predicted

    found = zip(*side_by_side(at, LEVELS, _LEVELS_TOGETHER), strict=True)
    highlight, dielectric, noise, peaks, predicted = (torch.stack(part, 1) for part in found)
    dull = low_mean(seen.linear, rays, valid)[near_rays.sample]
    plain = summed(near_seen.error(dull), near_rays)
    count = np.bincount(near_rays.sample, minlength=len(valid)).astype(np.float32)
    views = valid.sum(1).clamp(min=1)[:, None]
    highlights = Highlights(
        error=highlight.numpy(),
        plain=plain.numpy(),
        count=count,
        sample=near_rays.sample,
        seen=peaks.numpy(),
        predicted=predicted.numpy(),
        other=sample[others.numpy()],
        noise=noise.numpy(),
    )
    return highlights, (dielectric / views).numpy()


def estimate_specular(
    problem: Problem,
    light: Light,
    num_materials: int,
    seed: int,
) -> tuple[SpecularMaterial, Tensor]:
    """Specular material of every sample, and the diffuse radiance (S, V, 3) of every observation.

    `num_materials` patches of dielectrics have a roughness each; `seed` is of the clustering.
    """
    surfels = problem.scene.transport.surfels
    seen = np.flatnonzero(problem.radiance.seen.numpy())
    in_solve = np.isin(seen, problem.scene.rows)
    rows = seen[in_solve]
    looked = looked_at(problem, light, rows)
    highlights, dielectric = _costs(looked)
    trial = MaterialTrial(reflections=looked[0], rays=looked[1], seen=looked[2])
    features = _features(problem, light, seen)
    points, hue = _alike(problem, seen, features[:, :3])
    alike = points[in_solve], hue[in_solve]
    parts = find_metal((problem, light), rows, alike, trial, dielectric)
    parts, metal_choice = tested_parts(parts, trial, dielectric)
    is_metal = parts.part >= 0
    # the samples that took part speak for their neighbours
    part = parts.part[near(points[in_solve], points, 1)[:, 0]]
    cluster = clusters(features, num_materials, seed)
    patches = RoughnessPatches(features=means(features, cluster), number=cluster[in_solve])
    choice = choose_roughness(highlights, patches, trial, ~is_metal)
    level = choice.roughness[cluster]
    level[part >= 0] = parts.roughness[part[part >= 0]]
    metallic = (part >= 0).astype(np.float64)
    shown = choice.has_highlights
    layers, diffuse = _apply((problem, light), seen, level, metallic, shown)
    metal = np.zeros((len(surfels), 3), np.float32)
    if is_metal.any():
        nearest = cKDTree(surfels.position[rows[is_metal]]).query(surfels.position)[1]
        metal = parts.base[parts.part[is_metal][nearest]]
    return (
        SpecularMaterial(
            **layers,
            metal=metal,
            has_highlights=shown,
            table=_table((choice.roughness, cluster), (parts.roughness, part)),
            choices=(*choice.choices, metal_choice),
        ),
        diffuse,
    )


def with_material(
    problem: Problem,
    light: Light,
    specular: SpecularMaterial,
    samples: NDArray[np.bool_],
    material: tuple[Floats, Floats],
) -> tuple[SpecularMaterial, Tensor]:
    """The same with another roughness and metal, (S,) each, on some `samples` (S,) bool.

    Also the diffuse radiance (S, V, 3) of these; of the others it is what is seen.
    """
    rows = np.flatnonzero(samples & problem.radiance.seen.numpy())
    level, metal = (values[rows].astype(np.float64) for values in material)
    layers, diffuse = _apply((problem, light), rows, level, metal, specular.has_highlights)
    changed = {
        name: np.where(
            samples.reshape(-1, *[1] * (values.ndim - 1)), values, getattr(specular, name)
        )
        for name, values in {
            "roughness": material[0].astype(np.float32),
            "metallic": material[1].astype(np.float32),
            "floor": layers["floor"],
            "kept": layers["kept"],
        }.items()
    }
    return replace(specular, **changed), diffuse


def _alike(problem: Problem, seen: NDArray[np.int64], log_albedo: Floats) -> tuple[Floats, Floats]:
    """Points (N, 9), close where samples are classified together, and hues (N, 3)."""
    surfels = problem.scene.transport.surfels
    normal = _NORMAL_SCALE * surfels.normal[seen]
    points = np.concatenate([surfels.position[seen], normal, _ALBEDO_SCALE * log_albedo], axis=1)
    return points, log_albedo - log_albedo.mean(1, keepdims=True)


def _table(
    dielectrics: tuple[Reals, NDArray[np.int64]], metals: tuple[Reals, NDArray[np.int64]]
) -> tuple[dict[str, float], ...]:
    """Roughness and share of the samples (N,) of each patch and part (-1 if none)."""
    (patches, patch), (parts, part) = dielectrics, metals
    kinds = [(float(value), 0.0, (patch == k) & (part < 0)) for k, value in enumerate(patches)]
    kinds += [(float(value), 1.0, part == k) for k, value in enumerate(parts)]
    return tuple(
        {"roughness": roughness, "metallic": metallic, "share": float(chosen.mean())}
        for roughness, metallic, chosen in kinds
    )


def _features(problem: Problem, light: Light, seen: NDArray[np.int64]) -> Floats:
    """Log albedo, how much the views of a sample differ, and where it lies, (N, 7)."""
    observations = problem.scene.transport.observations
    irradiance = light.irradiance(problem, seen)
    albedo = np.pi * problem.radiance.linear[seen] / irradiance.clamp(min=1e-4)
    linear = problem.linear[seen].mean(2).clamp(min=1e-4)
    valid = torch.from_numpy(observations.weight[seen] > 0).float()
    mean = (linear.log() * valid).sum(1) / valid.sum(1)
    spread = (((linear.log() - mean[:, None]) ** 2 * valid).sum(1) / valid.sum(1)).sqrt()
    log_albedo = albedo.clamp(0.01, 1.0).log()
    look = torch.cat([log_albedo, _SPREAD_SCALE * spread[:, None]], 1).numpy()
    position = problem.scene.transport.surfels.position[seen]
    return np.concatenate([look, position], axis=1)


def _apply(
    solved: tuple[Problem, Light],
    seen: NDArray[np.int64],
    level: NDArray[np.float64],
    metal: NDArray[np.float64],
    has_highlights: bool,
) -> tuple[dict[str, Floats], Tensor]:
    """Layers of all samples, and the diffuse radiance of observations, metal's as seen."""
    (problem, light), scene = solved, solved[0].scene
    observations, surfels = scene.transport.observations, scene.transport.surfels
    num = len(surfels)
    diffuse = problem.linear.clone()
    floor = np.zeros((num, 3), np.float32)
    kept = np.ones((num, 1), np.float32)
    full_level, full_metal = np.full(num, UNKNOWN, np.float32), np.zeros(num, np.float32)
    full_level[seen], full_metal[seen] = level, metal
    for roughness in np.unique(level) if has_highlights else ():
        rows = seen[level == roughness]
        reflections = Reflections(problem, light, rows)
        rays = view_rays(surfels, observations, rows, scene.transport.visibility.directions)
        both = reflections.radiance(rays, float(roughness))
        shape = (len(rows), observations.weight.shape[1])
        dielectric = dense(both[:, 0], rays, shape)
        through = 1 - dense(reflected_share(rays, float(roughness))[:, None], rays, shape)
        linear = diffuse[rows]
        least = LEAST_DIFFUSE * linear
        below = torch.maximum(linear - dielectric, least) / through
        # the views that the textures are read from, see texture.py
        seen_by = observations.weight[rows], observations.positions
        share = texture_weights(seen_by, surfels.position[rows])[..., None]
        floor[rows] = (dielectric * share).sum(1).numpy()
        kept[rows] = (through * share).sum(1).numpy()
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
