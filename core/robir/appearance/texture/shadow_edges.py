# SPDX-License-Identifier: Apache-2.0
"""Albedo at shadow edges and where photographs are clipped: one of the surroundings'.

The share of sun is searched that makes a texel's albedo one that its surroundings have, near what
the rays say: RobIR's regularised visibility estimation (METHOD 2.7), per texel, without a network.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from robir.appearance.light.problem import Problem, Scene
from robir.appearance.light.solver import Light
from robir.appearance.light.sunlight import EDGE_SHARPNESS
from robir.appearance.texture.residual_shading import with_normals
from robir.appearance.texture.texels import NORMAL_SCALE, Texels, sun_transfer
from robir.maths.vectors import orthonormal_frame
from robir.transport.visibility import lobe_transfer
from robir.workers import blocks, num_workers, side_by_side

Floats = NDArray[np.float32]
Reals = NDArray[np.floating[Any]]

# texels at shadows' edges that are settled at a time: their palettes then stay small
EDGE_CHUNK = 1 << 13

_RAY_PAIRS = 6  # pairs of opposite rays by which the share of a sun's wide lobe is told
_LEAST_SHARE = 0.02  # share of it from which a texel is at an edge, up to as little below 1
_LEAST_STRENGTH = 0.1  # irradiance of a sun over that of the sky below which it casts no edge
_MESH_ERROR = 0.02  # error of the mesh along the surface that a shadow may have, unit frame
# albedo that hardly anything exceeds: a texel in shadow that does was taken for shaded wrongly
_BRIGHTEST = 0.9
_REFERENCE_STEP = 8  # every so manieth certain texel is looked up, so that a few reach far
# certain texels whose albedos one at an edge may have. The nearest few lie on one side of the
# uncertain band and lack the other material of a border within it.
_PALETTE = 128
_NUM_SHARES = 11  # shares of the sun that are tried, from none to all
# difference of log albedo, summed over the channels, that a share differing from the traced one by
# all of the sun is worth
_TRACED_WEIGHT = 0.3
_CLIPPED_PALETTE = 8  # certain texels about one that is clipped
_CLIPPED_QUANTILE = 0.8  # of their albedos, that it takes


@dataclass(frozen=True, slots=True, kw_only=True)
class ShadowBorders:
    """Where it is not known how much of a sun arrives, whatever the material."""

    facing: Floats  # (N, J) what would arrive of each sun, were nothing between, at least 0
    partly: NDArray[np.bool_]  # (N, J) whether less than all of a sun arrives
    uncertain: NDArray[np.bool_]  # (N, J) whether it is not known how much
    casts: NDArray[np.bool_]  # (N, J) whether a sun is strong enough there to cast an edge

    @classmethod
    def of(cls, problem: Problem, light: Light, texels: Texels, sky: float) -> ShadowBorders:
        """By the mesh's own shadows.

        `sky` is the mean irradiance of the sky, beside which a weak sun casts no edge.
        """
        strength = light.amplitudes.sharp.numpy().mean(1) / max(1e-6, sky)
        sharpness = np.full(len(light.axes), EDGE_SHARPNESS, np.float32)
        wide = sun_transfer(problem, light, texels, sharpness, 2 * _RAY_PAIRS)
        points = (texels.position, texels.normal)
        facing = np.clip(problem.scene.facing(points, light.axes), 0, None)
        share = wide / np.maximum(facing, 1e-3)
        partly = share < 1 - _LEAST_SHARE
        uncertain = (share > _LEAST_SHARE) & partly
        uncertain |= _contested(problem.scene, light, texels, _MESH_ERROR)
        casts = facing * strength > _LEAST_STRENGTH
        return cls(facing=facing, partly=partly, uncertain=uncertain, casts=casts)

    def on_edges(self, albedo: Floats) -> NDArray[np.bool_]:
        """Texels (N,) where it is not known how much sun arrives, by albedo (N, 3) so far."""
        is_bright = albedo.max(1) > _BRIGHTEST
        return ((self.uncertain | (self.partly & is_bright[:, None])) & self.casts).any(1)


def _contested(scene: Scene, light: Light, texels: Texels, mesh_error: float) -> NDArray[np.bool_]:
    """Whether points a mesh error away along the surface see a sun differently, (N, J)."""
    first, second = orthonormal_frame(torch.from_numpy(texels.normal))
    if not len(light.axes):
        return np.zeros((len(texels.position), 0), bool)
    lit = []
    for step in (0 * first, first, -first, second, -second):
        position = texels.position + mesh_error * step.numpy()
        columns = [
            lobe_transfer(
                scene.tracer,
                position,
                texels.normal,
                axis[None],
                scene.offset,
                scene.light_distance,
            )
            > 0
            for axis in light.axes
        ]
        lit.append(np.stack(columns, axis=1))
    count = np.sum(lit, axis=0)
    return (count > 0) & (count < len(lit))


class Reference:
    """Texels whose albedo is certain, to look up what the surroundings are like."""

    def __init__(self, texels: Texels, albedo: Floats, certain: NDArray[np.bool_]) -> None:
        if certain.sum() < 8:
            certain = np.ones(len(albedo), bool)
        self._points = with_normals(texels.position, texels.normal, NORMAL_SCALE)[certain]
        self._albedo = albedo[certain]
        self._thinned = cKDTree(self._points[::_REFERENCE_STEP])

    def nearest_albedo(self, texels: Texels, rows: NDArray[np.bool_]) -> Floats:
        """Mean albedo (M, 3) of the few nearest certain texels."""
        if not rows.any():
            return np.zeros((0, 3), np.float32)
        query = with_normals(texels.position[rows], texels.normal[rows], NORMAL_SCALE)
        # hardly any of them lies next to one that is seen: twice the least distance will do
        index = cKDTree(self._points).query(query, k=4, eps=1.0, workers=num_workers())[1]
        return self._albedo[index].mean(1)

    def palette(self, texels: Texels, rows: NDArray[np.int64], count: int) -> Floats:
        """Albedos (M, count, 3) around some texels; fewer where there are not as many."""
        query = with_normals(texels.position[rows], texels.normal[rows], NORMAL_SCALE)
        count = min(count, self._thinned.n)
        index = self._thinned.query(
            query, k=np.arange(1, count + 1), eps=0.2, workers=num_workers()
        )[1]
        return self._albedo[::_REFERENCE_STEP][index]


def solve_shadow_edges(
    diffuse: tuple[Floats, Floats],
    arriving: tuple[Floats, Floats, Floats],
    facing: Floats,
    texels: Texels,
    edge: NDArray[np.bool_],
    reference: Reference,
) -> Floats:
    """Albedo by the share of sun at shadow edges (N,) that makes it one of the surroundings'.

    `diffuse` is albedo (N, 3) by the mesh's own shadows, and radiosity (N, 3); `arriving` is
    irradiance (N, 3) from all but the suns, visibility times cosine of these (N, J), and what they
    send (J, 3); `facing` (N, J) is what would arrive of each, were nothing between, at least 0;
    `reference` are certain texels.
    """
    (albedo, exitant), (soft, narrow, sun) = diffuse, arriving
    strongest = int(sun.mean(1).argmax())
    others = [index for index in range(len(sun)) if index != strongest]
    rest = soft[edge] + narrow[edge][:, others] @ sun[others]
    full = facing[edge, strongest][:, None] * sun[strongest]
    traced = narrow[edge, strongest] / np.maximum(facing[edge, strongest], 1e-3)
    rows = np.flatnonzero(edge)
    solved = albedo.copy()

    def matched(part: slice) -> Floats:
        surroundings = reference.palette(texels, rows[part], _PALETTE)
        return _best_match(
            exitant[rows[part]], (rest[part], full[part], traced[part]), surroundings
        )

    parts = side_by_side(matched, blocks(len(rows), EDGE_CHUNK))
    solved[rows] = np.concatenate(parts)
    return solved


def _best_match(exitant: Floats, sun: tuple[Reals, Reals, Reals], surroundings: Floats) -> Floats:
    """Of albedos that shares of sun would give, the one (M, 3) most like those (M, K, 3) about."""
    rest, full, traced = sun
    # a channel at a time: sums over a last axis of three are ten times slower
    palette = np.log(np.clip(surroundings, 1e-3, None)).astype(np.float32).transpose(2, 0, 1).copy()
    few = min(3, palette.shape[2])
    best = np.full(len(exitant), np.inf)
    result = np.empty((len(exitant), 3), np.float32)
    for share in np.linspace(0.0, 1.0, _NUM_SHARES):
        trial = exitant / np.maximum(rest + share * full, 1e-6)
        log = np.log(np.clip(trial, 1e-3, None)).astype(np.float32)
        distance = sum(np.abs(palette[c] - log[:, c, None]) for c in range(3))
        nearest = np.partition(distance, few - 1, axis=1)[:, :few].mean(1)
        cost = nearest + _TRACED_WEIGHT * np.abs(share - traced)
        better = cost < best
        best[better] = cost[better]
        result[better] = trial[better]
    return result


def fill_clipped(
    albedo: Floats, clipped: NDArray[np.bool_], reference: Reference, texels: Texels
) -> Floats:
    """Where a channel was clipped, the brightest certain surroundings, never less than measured."""
    rows = np.flatnonzero(clipped.any(1))
    palette = reference.palette(texels, rows, _CLIPPED_PALETTE)
    around = np.quantile(palette, _CLIPPED_QUANTILE, axis=1)
    solved = albedo.copy()
    raised = np.maximum(albedo[rows], around)
    solved[rows] = np.where(clipped[rows], raised, albedo[rows])
    return solved
