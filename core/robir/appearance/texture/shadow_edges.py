# SPDX-License-Identifier: Apache-2.0
"""Albedo where a shadow's edge runs, or where photographs are clipped: one of the surroundings'.

There the mesh is never exact enough to say how much sun arrives. The share of sun is searched that
makes the texel's albedo one that its surroundings have, and near what the rays say: RobIR's
regularised visibility estimation (METHOD 2.7), per texel and without a network.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from robir.appearance.light.problem import Problem, Scene
from robir.appearance.light.solver import Light
from robir.appearance.texture.config import ShadowEdgesConfig, TextureConfig
from robir.appearance.texture.residual_shading import with_normals
from robir.appearance.texture.texels import Texels, sun_transfer
from robir.maths.vectors import orthonormal_frame
from robir.transport.visibility import lobe_transfer

Floats = NDArray[np.float32]
Reals = NDArray[np.floating[Any]]

EDGE_CHUNK = 1 << 13
"""Texels at shadows' edges that are settled at a time: their palettes then stay small."""


def on_edges(
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
    config = problem.scene.config.texture.shadow_edges
    edge_sharpness = problem.scene.config.light.sunlight.edge_sharpness
    sharpness = np.full(len(light.axes), edge_sharpness, np.float32)
    wide = sun_transfer(problem, light, texels, sharpness, 2 * config.ray_pairs)
    facing = np.clip(texels.normal @ light.axes.T, 0, None)
    share = wide / np.maximum(facing, 1e-3)
    partly = share < 1 - config.least_share
    unsure = (share > config.least_share) & partly
    unsure |= _contested(problem.scene, light, texels, config.mesh_error)
    unsure |= partly & (albedo.max(1) > config.brightest)[:, None]
    return (unsure & (facing * strength > config.least_strength)).any(1)


def _contested(scene: Scene, light: Light, texels: Texels, mesh_error: float) -> NDArray[np.bool_]:
    """Whether points a mesh error away along the surface see a sun differently, (N, J).

    The lobe of `edge_sharpness` spans little where the blocker is near; contact shadows are found
    by stepping aside instead.
    """
    first, second = orthonormal_frame(torch.from_numpy(texels.normal))
    lit = []
    for step in (0 * first, first, -first, second, -second):
        position = texels.position + mesh_error * step.numpy()
        columns = [
            lobe_transfer(scene.tracer, position, texels.normal, axis[None], scene.offset) > 0
            for axis in light.axes
        ]
        lit.append(np.stack(columns, axis=1))
    count = np.sum(lit, axis=0)
    return (count > 0) & (count < len(lit))


class Reference:
    """Texels whose albedo is certain, to look up what the surroundings are like.

    Attributes:
        config: Of edges, and of what is clipped.
    """

    def __init__(
        self,
        texels: Texels,
        albedo: Floats,
        certain: NDArray[np.bool_],
        config: TextureConfig,
    ) -> None:
        if certain.sum() < 8:
            certain = np.ones(len(albedo), bool)
        self.config = config.shadow_edges
        self._scale = config.texels.normal_scale
        self._points = with_normals(texels.position, texels.normal, self._scale)[certain]
        self._albedo = albedo[certain]
        self._thinned = cKDTree(self._points[:: self.config.reference_step])

    def nearest_albedo(self, texels: Texels, rows: NDArray[np.bool_]) -> Floats:
        """Mean albedo (M, 3) of the few nearest certain texels."""
        if not rows.any():
            return np.zeros((0, 3), np.float32)
        query = with_normals(texels.position[rows], texels.normal[rows], self._scale)
        # hardly any of them lies next to one that is seen: twice the least distance will do
        index = cKDTree(self._points).query(query, k=4, eps=1.0)[1]
        return self._albedo[index].mean(1)

    def palette(self, texels: Texels, rows: NDArray[np.int64], count: int) -> Floats:
        """Albedos (M, count, 3) around some texels; fewer where there are not as many."""
        query = with_normals(texels.position[rows], texels.normal[rows], self._scale)
        count = min(count, self._thinned.n)
        index = self._thinned.query(query, k=np.arange(1, count + 1), eps=0.2)[1]
        return self._albedo[:: self.config.reference_step][index]


def settle_edges(
    paint: tuple[Floats, Floats],
    arriving: tuple[Floats, Floats, Floats],
    light: Light,
    texels: Texels,
    edge: NDArray[np.bool_],
    reference: Reference,
) -> Floats:
    """Albedo by the share of sun at shadow edges that makes it one of the surroundings'.

    Args:
        paint: Albedo (N, 3) by the mesh's own shadows, and radiosity (N, 3).
        arriving: Irradiance (N, 3) from all but the suns, visibility times cosine of these (N, J),
            and what they send (J, 3).
        light: Solved light.
        texels: The N texels.
        edge: (N,) those at edges.
        reference: Certain texels.
    """
    config = reference.config
    (albedo, exitant), (soft, narrow, sun) = paint, arriving
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
        among = reference.palette(texels, rows[part], config.palette)
        settled[rows[part]] = _likeliest(
            exitant[rows[part]], (rest[part], full[part], traced[part]), among, config
        )
    return settled


def _likeliest(
    exitant: Floats,
    sun: tuple[Reals, Reals, Reals],
    among: Floats,
    config: ShadowEdgesConfig,
) -> Floats:
    """Of the albedos that shares of sun would give, the one most like some surroundings'.

    Args:
        exitant: (M, 3) pi times diffuse radiance.
        sun: Irradiance without the sun (M, 3), that of the whole sun (M, 3), and the share (M,) of
            it that the rays say.
        among: (M, K, 3) albedos of the surroundings.
        config: Shares that are tried, and what the rays count.

    Returns:
        (M, 3).
    """
    rest, full, traced = sun
    # a channel at a time: sums over a last axis of three are ten times slower
    palette = np.log(np.clip(among, 1e-3, None)).astype(np.float32).transpose(2, 0, 1).copy()
    few = min(3, palette.shape[2])
    best = np.full(len(exitant), np.inf)
    result = np.empty((len(exitant), 3), np.float32)
    for share in np.linspace(0.0, 1.0, config.num_shares):
        trial = exitant / np.maximum(rest + share * full, 1e-6)
        log = np.log(np.clip(trial, 1e-3, None)).astype(np.float32)
        distance = sum(np.abs(palette[c] - log[:, c, None]) for c in range(3))
        nearest = np.partition(distance, few - 1, axis=1)[:, :few].mean(1)
        cost = nearest + config.traced_weight * np.abs(share - traced)
        better = cost < best
        best[better] = cost[better]
        result[better] = trial[better]
    return result


def settle_clipped(
    albedo: Floats, clipped: NDArray[np.bool_], reference: Reference, texels: Texels
) -> Floats:
    """Where a channel was clipped, the brightest certain surroundings, never less than measured."""
    rows = np.flatnonzero(clipped.any(1))
    config = reference.config
    palette = reference.palette(texels, rows, config.clipped_palette)
    around = np.quantile(palette, config.clipped_quantile, axis=1)
    settled = albedo.copy()
    raised = np.maximum(albedo[rows], around)
    settled[rows] = np.where(clipped[rows], raised, albedo[rows])
    return settled
