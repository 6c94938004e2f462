# SPDX-License-Identifier: Apache-2.0
"""Albedo per texel, read from the photographs under the solved light.

Every texel is projected into the photographs, its radiance divided by its own irradiance: soft
light and bounces vary slowly and come from the samples, the suns are traced per texel. Where a
shadow's edge runs, the mesh is never exact enough to say how much sun arrives. There the share of
sun is searched that makes the texel's albedo one that its surroundings have, and near what the rays
say: RobIR's regularised visibility estimation (METHOD 2.7), per texel and without a network.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from torch import Tensor

from robir.appearance.light.problem import Problem, Scene
from robir.appearance.light.shade import irradiance_doubt
from robir.appearance.light.solver import Light
from robir.appearance.light.sunlight import EDGE_SHARPNESS
from robir.appearance.material.gloss import Gloss
from robir.appearance.photometry.statistics import (
    display_mean,
    linear_observations,
    texture_weights,
    weighted_radiance,
)
from robir.appearance.texture.residual_shading import evened, most_albedo, with_normals
from robir.appearance.texture.sharpen import sharpened
from robir.appearance.texture.uncertainty import distance_to_seen, standard_error
from robir.capture.capture import View
from robir.geometry.mesh.tracing import AbstractTracer
from robir.maths.vectors import orthonormal_frame
from robir.transport.observe import Observations, observe
from robir.transport.visibility import lobe_transfer

Floats = NDArray[np.float32]
Reals = NDArray[np.floating[Any]]

SIDE_STEP = 0.02
"""Error of the mesh along the surface that a shadow may have, unit frame."""

REFERENCE_STEP = 8
"""Every so manieth certain texel is looked up, so that a few of them reach far."""

EDGE_PALETTE = 128
"""Certain texels whose albedos one at a shadow's edge may have. The nearest few all lie on one side
of the uncertain band: where the band also holds a border of two paints, the other paint was
missing, and the share of sun was bent until the near one fitted. Of 8, 32, 64 and 128 each gave
better re-renders than the one before."""

EDGE_CHUNK = 1 << 13
"""Texels at shadows' edges that are settled at a time: their palettes then stay small."""

GLOSS_ERROR = 0.4
"""Error of the specular light that is subtracted, over itself: little is known of a dark material
in the shade, most of whose light is reflected."""

BRIGHTEST = 0.9
"""Albedo that hardly anything exceeds: a texel in shadow that does was taken for shaded wrongly."""

SUN_SHARES = np.linspace(0.0, 1.0, 11)

MIN_ALBEDO, MAX_ALBEDO = 0.002, 0.95


@dataclass(frozen=True, slots=True, kw_only=True)
class Texels:
    """Surface points of the texture atlas.

    Attributes:
        position: (N, 3) unit frame.
        normal: (N, 3) unit.
    """

    position: Floats
    normal: Floats


@dataclass(frozen=True, slots=True, kw_only=True)
class TexelAlbedo:
    """Albedo of the texels with how well it is known.

    Attributes:
        albedo: (N, 3) float32, linear Rec.709.
        coverage: (N,) int, views that show the texel.
        disagreement: (N,) float32, one standard deviation of log albedo by views, shadow edges and
            dim light: a sign of a wrong mesh, wrong poses or uneven exposure.
        read: (N, 3) float32, albedo as the photographs have it, before it was evened.
        unknown: (N,) float32, one standard deviation of its logarithm.
        uncertainty: (N,) float32, one standard error of log albedo, see uncertainty.py.
        roughness: (N,) float32.
        metallic: (N,) float32, 0 or 1.
    """

    albedo: Floats
    coverage: NDArray[np.int64]
    disagreement: Floats
    read: Floats
    unknown: Floats
    uncertainty: Floats
    roughness: Floats
    metallic: Floats


class Blend:
    """Interpolates values of the surface samples at texels, from those alike in orientation.

    Attributes:
        nearest: (N,) the one sample nearest to each texel.
    """

    def __init__(self, problem: Problem, texels: Texels) -> None:
        """Find the nearest samples of every texel, once.

        Args:
            problem: Scene with its samples.
            texels: Where values are wanted.
        """
        surfels = problem.scene.transport.surfels
        seen = np.flatnonzero(problem.radiance.seen.numpy())
        points = with_normals(surfels.position, surfels.normal)[seen]
        query = with_normals(texels.position, texels.normal)
        distance, index = cKDTree(points).query(query, k=4, eps=0.1)
        weight = 1 / (distance + 0.2 * surfels.spacing) ** 2
        self._index = seen[index]
        self.nearest = self._index[:, 0]
        self._weight = (weight / weight.sum(1, keepdims=True)).astype(np.float32)

    def __call__(self, values: Tensor) -> Floats:
        """Values (S, C) of all samples at the texels, (N, C)."""
        return np.einsum("nk,nkc->nc", self._weight, values.numpy()[self._index])


def sun_transfer(
    problem: Problem, light: Light, texels: Texels, sharpness: Floats, samples: int
) -> Floats:
    """Visibility times cosine of every sharp lobe at every texel, (N, J)."""
    points = (texels.position, texels.normal)
    return problem.scene.sharp_transfer_at(points, light.axes, sharpness, samples)


def texel_albedo(
    problem: Problem,
    light: Light,
    texels: Texels,
    views: tuple[View, ...],
    gloss: Gloss,
    tracer: AbstractTracer,
) -> TexelAlbedo:
    """Albedo of every texel.

    Args:
        problem: Scene under the chosen tone curve.
        light: Solved light.
        texels: Points of the atlas.
        views: Photographs, at the size they are to be read at.
        gloss: Specular material of the samples.
        tracer: Tracer of the mesh.

    Returns:
        Albedo (base colour where the material is metal), how well it is known, roughness and metal;
        texels no view shows take their neighbours' albedo.
    """
    scene = problem.scene
    blend = Blend(problem, texels)
    soft = blend(scene.soft @ light.amplitudes.soft + problem.indirect)
    floor = blend(torch.from_numpy(gloss.floor))
    kept = blend(torch.from_numpy(gloss.kept))
    metallic = blend(torch.from_numpy(gloss.metallic)[:, None])[:, 0] > 0.5
    roughness = blend(torch.from_numpy(gloss.roughness)[:, None])[:, 0]
    narrow = sun_transfer(problem, light, texels, light.sharpness, 8)
    sun = light.amplitudes.sharp.numpy()
    seen = observe(tracer, texels.position, texels.normal, views, scene.offset)
    linear = linear_observations(seen, problem.curve, problem.gains)
    total, clipped = _as_photographed(problem, seen, linear, texels, views, gloss)
    irradiance = soft + narrow @ sun
    below = np.maximum(total - floor, 0.1 * total)
    exitant = np.pi * below / kept
    albedo = exitant / np.hypot(irradiance, 0.02 * irradiance.mean(0))
    albedo[metallic] = blend(torch.from_numpy(gloss.metal))[metallic]
    coverage = (seen.weight > 0).sum(1)
    certain = coverage >= 2
    edge = _on_edges(problem, light, texels, albedo, float(soft.mean())) & ~metallic
    certain &= ~edge & ~clipped.any(1)
    reference = _Reference(texels, albedo, certain)
    albedo = _settle_edges(albedo, exitant, (soft, narrow, sun), light, texels, edge, reference)
    albedo = _settle_clipped(albedo, clipped, reference, texels)
    albedo[coverage == 0] = reference.nearest_albedo(texels, coverage == 0)
    spread = _spread(linear, seen)
    albedo = np.clip(albedo, MIN_ALBEDO, MAX_ALBEDO)
    doubt = irradiance_doubt(torch.from_numpy(irradiance)).numpy()
    reflected = GLOSS_ERROR * floor.mean(1) / below.mean(1)
    known = np.sqrt(spread**2 + np.where(edge, 0.25, 0.05) ** 2 + doubt**2)
    disagreement = np.where(coverage > 0, known, 1.0).clip(0.0, 1.0)
    unknown = np.hypot(disagreement, reflected).clip(0.0, 1.0)
    points = with_normals(texels.position, texels.normal)
    most = most_albedo(albedo, total * kept / below, disagreement)
    smooth = np.minimum(evened(albedo, unknown, points), most).clip(MIN_ALBEDO, MAX_ALBEDO)
    distance = distance_to_seen(texels.position, coverage > 0)
    changed = np.abs(np.log(smooth / albedo)).mean(1)
    return TexelAlbedo(
        albedo=smooth.astype(np.float32),
        coverage=coverage,
        disagreement=disagreement.astype(np.float32),
        read=albedo.astype(np.float32),
        unknown=unknown.astype(np.float32),
        uncertainty=standard_error(spread, changed, coverage, distance),
        roughness=roughness.astype(np.float32),
        metallic=metallic.astype(np.float32),
    )


def _as_photographed(
    problem: Problem,
    seen: Observations,
    linear: Tensor,
    texels: Texels,
    views: tuple[View, ...],
    gloss: Gloss,
) -> tuple[Floats, NDArray[np.bool_]]:
    """Radiance (N, 3) that stands for all views of the texels, and which channels are clipped.

    Darker views show what is diffuse below a specular layer; a camera's photographs are darker for
    many other reasons too, and the asset came out darker than they are.
    """
    below_gloss = gloss.has_highlights and not problem.scene.by_camera
    observed = seen.weight, seen.positions
    share = texture_weights(observed, texels.position, linear, below_gloss=below_gloss)
    radiance = weighted_radiance(seen, linear, share)
    shown = radiance.linear if below_gloss else display_mean(linear, share, problem.curve)
    read = (linear.numpy(), share.numpy(), seen.weight)
    total = sharpened(shown.clamp(min=1e-5).numpy(), read, texels.position, views)
    return total, radiance.clipped.numpy()


def _on_edges(
    problem: Problem, light: Light, texels: Texels, albedo: Floats, sky: float
) -> NDArray[np.bool_]:
    """Texels where nobody knows how much sun arrives, (N,).

    Args:
        problem: Scene under the chosen tone curve.
        light: Solved light.
        texels: Points of the atlas.
        albedo: (N, 3) by the mesh's own shadows.
        sky: Mean irradiance without the suns; one that is weak beside it casts no edge.
    """
    if not len(light.axes):
        return np.zeros(len(albedo), bool)
    strength = light.amplitudes.sharp.numpy().mean(1) / max(1e-6, sky)
    sharpness = np.full(len(light.axes), EDGE_SHARPNESS, np.float32)
    wide = sun_transfer(problem, light, texels, sharpness, 12)
    facing = np.clip(texels.normal @ light.axes.T, 0, None)
    share = wide / np.maximum(facing, 1e-3)
    unsure = (share > 0.02) & (share < 0.98) | _contested(problem.scene, light, texels)
    unsure |= (share < 0.98) & (albedo.max(1) > BRIGHTEST)[:, None]
    return (unsure & (facing * strength > 0.1)).any(1)


def _contested(scene: Scene, light: Light, texels: Texels) -> NDArray[np.bool_]:
    """Whether points a mesh error away along the surface see a sun differently, (N, J).

    The lobe of EDGE_SHARPNESS spans little where the blocker is near; contact shadows are found by
    stepping aside instead.
    """
    first, second = orthonormal_frame(torch.from_numpy(texels.normal))
    lit = []
    for step in (0 * first, first, -first, second, -second):
        position = texels.position + SIDE_STEP * step.numpy()
        columns = [
            lobe_transfer(scene.tracer, position, texels.normal, axis[None], scene.offset) > 0
            for axis in light.axes
        ]
        lit.append(np.stack(columns, axis=1))
    count = np.sum(lit, axis=0)
    return (count > 0) & (count < len(lit))


def _spread(linear: Tensor, seen: Observations) -> Floats:
    """Standard error over views of the log of a texel's brightness, (N,)."""
    valid = torch.from_numpy(seen.weight > 0).float()
    count = valid.sum(1).clamp(min=1)
    log = linear.mean(2).clamp(min=1e-4).log()
    mean = (log * valid).sum(1) / count
    variance = ((log - mean[:, None]) ** 2 * valid).sum(1) / count
    return (variance / count).sqrt().numpy()


class _Reference:
    """Texels whose albedo is certain, to look up what the surroundings are like."""

    def __init__(self, texels: Texels, albedo: Floats, certain: NDArray[np.bool_]) -> None:
        if certain.sum() < 8:
            certain = np.ones(len(albedo), bool)
        self._points = with_normals(texels.position, texels.normal)[certain]
        self._albedo = albedo[certain]
        self._thinned = cKDTree(self._points[::REFERENCE_STEP])

    def nearest_albedo(self, texels: Texels, rows: NDArray[np.bool_]) -> Floats:
        """Mean albedo (M, 3) of the few nearest certain texels."""
        if not rows.any():
            return np.zeros((0, 3), np.float32)
        query = with_normals(texels.position[rows], texels.normal[rows])
        # hardly any of them lies next to one that is seen: twice the least distance will do
        index = cKDTree(self._points).query(query, k=4, eps=1.0)[1]
        return self._albedo[index].mean(1)

    def palette(self, texels: Texels, rows: NDArray[np.int64], count: int) -> Floats:
        """Albedos (M, count, 3) around some texels; fewer where there are not as many."""
        query = with_normals(texels.position[rows], texels.normal[rows])
        count = min(count, self._thinned.n)
        index = self._thinned.query(query, k=np.arange(1, count + 1), eps=0.2)[1]
        return self._albedo[::REFERENCE_STEP][index]


def _settle_edges(
    albedo: Floats,
    exitant: Floats,
    parts: tuple[Floats, Floats, Floats],
    light: Light,
    texels: Texels,
    edge: NDArray[np.bool_],
    reference: _Reference,
) -> Floats:
    """Share of sun at shadow edges that makes the albedo one of the surroundings'."""
    if not edge.any():
        return albedo
    soft, narrow, sun = parts
    facing = np.clip(texels.normal @ light.axes.T, 0, None)
    strongest = int(sun.mean(1).argmax())
    others = [index for index in range(len(sun)) if index != strongest]
    rest = soft[edge] + narrow[edge][:, others] @ sun[others]
    full = facing[edge, strongest][:, None] * sun[strongest]
    traced = narrow[edge, strongest] / np.maximum(facing[edge, strongest], 1e-3)
    rows = np.flatnonzero(edge)
    settled = albedo.copy()
    for start in range(0, len(rows), EDGE_CHUNK):
        part = slice(start, start + EDGE_CHUNK)
        among = reference.palette(texels, rows[part], EDGE_PALETTE)
        settled[rows[part]] = _likeliest(
            exitant[rows[part]], (rest[part], full[part], traced[part]), among
        )
    return settled


def _likeliest(exitant: Floats, sun: tuple[Reals, Reals, Reals], among: Floats) -> Floats:
    """Of the albedos that shares of sun would give, the one most like some surroundings'.

    Args:
        exitant: (M, 3) pi times diffuse radiance.
        sun: Irradiance without the sun (M, 3), that of the whole sun (M, 3), and the share (M,) of
            it that the rays say.
        among: (M, K, 3) albedos of the surroundings.

    Returns:
        (M, 3).
    """
    rest, full, traced = sun
    # a channel at a time: sums over a last axis of three are ten times slower
    palette = np.log(np.clip(among, 1e-3, None)).astype(np.float32).transpose(2, 0, 1).copy()
    few = min(3, palette.shape[2])
    best = np.full(len(exitant), np.inf)
    result = np.empty((len(exitant), 3), np.float32)
    for share in SUN_SHARES:
        trial = exitant / np.maximum(rest + share * full, 1e-6)
        log = np.log(np.clip(trial, 1e-3, None)).astype(np.float32)
        distance = sum(np.abs(palette[c] - log[:, c, None]) for c in range(3))
        nearest = np.partition(distance, few - 1, axis=1)[:, :few].mean(1)
        cost = nearest + 0.3 * np.abs(share - traced)
        better = cost < best
        best[better] = cost[better]
        result[better] = trial[better]
    return result


def _settle_clipped(
    albedo: Floats, clipped: NDArray[np.bool_], reference: _Reference, texels: Texels
) -> Floats:
    """Where a channel was clipped, the brightest certain surroundings, never less than measured."""
    rows = np.flatnonzero(clipped.any(1))
    if not len(rows):
        return albedo
    around = np.quantile(reference.palette(texels, rows, 8), 0.8, axis=1)
    settled = albedo.copy()
    raised = np.maximum(albedo[rows], around)
    settled[rows] = np.where(clipped[rows], raised, albedo[rows])
    return settled
