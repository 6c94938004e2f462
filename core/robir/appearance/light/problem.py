# SPDX-License-Identifier: Apache-2.0
"""The light problem of one scene under one tone curve: what is known, sub-sampled."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from torch import Tensor

from robir.appearance.held_out_test import block_numbers
from robir.appearance.light.known_albedo import KnownAlbedo
from robir.appearance.light.lobes import MEAN_ALBEDO, Transfer, soft_transfer
from robir.appearance.photometry.exposure import ExposureModel, Gains
from robir.appearance.photometry.statistics import (
    Pairs,
    Radiance,
    diffuse_radiance,
    linear_observations,
    neighbour_pairs,
)
from robir.geometry.mesh.tracer import EmbreeTracer
from robir.maths.tone_curve import AbstractToneCurve
from robir.transport.baked import Transport
from robir.transport.visibility import cosines, lobe_directions, lobe_transfer, towards_light
from robir.workers import blocks, num_workers, side_by_side

Floats = NDArray[np.float32]

# distances over which albedos are compared: below and above the width of a shadow (unit frame)
PAIR_REACHES = (0.05, 0.12, 0.25)
# partners of a sample at each of these distances; with half as many the light hangs on chance
_NUM_PARTNERS = 6
_EVERY_PARTNERS = 3  # the same where every sample takes part
# radiance of a surface in the shade, open to the whole sky, over the median of what is seen
_SKY_SHARE = 0.3
_LOOK_ALIKES = 64  # seen samples that tell a hidden one's albedo, the nearest
_LOOK_ALIKE_RANK = 0.9  # rank among them that does: the brighter ones are those in the light
_LEAST_HIDDEN_ALBEDO = 0.05  # least albedo of what no camera sees
_MOST_HIDDEN_ALBEDO = 0.8  # greatest albedo of that
_RAYS_TOGETHER = 1 << 14  # points whose rays are traced at a time
_NUM_BOUNCES = 3  # reflections between surfaces that no camera sees
SUN_RAY_PAIRS = 4  # pairs of opposite rays that sample a sun at a point


@dataclass(frozen=True, slots=True)
class Scene:
    """What does not depend on the tone curve."""

    transport: Transport  # baked samples, visibility, observations
    tracer: EmbreeTracer | None  # tracer of the mesh; None when nothing blocks light
    soft: Tensor  # (S, K) irradiance for unit amplitude of the soft lobes
    offset: float  # distance that rays start above the surface
    # (U,) samples that take part in the light solve; all are seen by two views or more
    rows: NDArray[np.int64]
    pairs: Pairs  # neighbours among them
    # where the photographs were not exposed alike, their exposures' model; else None
    exposures: ExposureModel | None = None
    known_albedo: KnownAlbedo | None = None  # a spot whose albedo the user knows, if any
    sun: Floats | None = None  # (3,) unit, towards the first sun, if the user knows it
    # of all lights from the origin, unit frame: a room's walls and lamps are near, a sky is not
    light_distance: float = np.inf

    def lit_from(self, distance: float) -> Scene:
        """The scene whose lights are so far from the origin of the frame."""
        transport, count = self.transport, self.soft.shape[1]
        soft = soft_transfer(transport.visibility, transport.surfels, count, distance)
        return replace(self, soft=soft, light_distance=distance)

    def bounced(self, exitant: Tensor) -> Tensor:
        """Irradiance (S, 3) of all samples from what all of them radiate, (S, 3)."""
        bounce = self.transport.visibility.bounce
        return torch.from_numpy(np.asarray(bounce @ exitant.numpy(), np.float32))

    def sharp_transfer(self, axes: Floats, sharpness: Floats, rows: NDArray[np.int64]) -> Tensor:
        """Irradiance (len(rows), J) for unit energy of sharp lobes, traced."""
        surfels = self.transport.surfels
        points = (surfels.position[rows], surfels.normal[rows])
        rays = 2 * SUN_RAY_PAIRS
        return torch.from_numpy(self.sharp_transfer_at(points, axes, sharpness, rays))

    def facing(self, points: tuple[Floats, Floats], axes: Floats) -> Floats:
        """What points (N, 3) with normals (N, 3) would receive of each sharp lobe, (N, J).

        Per unit of energy, were nothing between; below 0 where they face away.
        """
        position, normal = points
        columns = []
        for axis in axes:
            ray, strength = towards_light(position, axis, self.light_distance)
            columns.append(cosines(normal, ray) * strength)
        return np.stack(columns, axis=1) if columns else np.zeros((len(position), 0), np.float32)

    def sharp_transfer_at(
        self, points: tuple[Floats, Floats], axes: Floats, sharpness: Floats, samples: int
    ) -> Floats:
        """The same (N, J) at positions and normals (N, 3), unit frame, by `samples` rays a lobe."""
        position, normal = points
        lobes = [
            lobe_directions(axis, float(width), samples)
            for axis, width in zip(axes, sharpness, strict=True)
        ]

        def traced(part: slice) -> Floats:
            points = position[part], normal[part]
            columns = [
                lobe_transfer(self.tracer, *points, lobe, self.offset, self.light_distance)
                for lobe in lobes
            ]
            return np.stack(columns, axis=1)

        if not lobes or not len(position):
            return np.zeros((len(position), len(lobes)), np.float32)
        return np.concatenate(side_by_side(traced, blocks(len(position), _RAYS_TOGETHER)))


def make_scene(
    transport: Transport,
    tracer: EmbreeTracer | None,
    offset: float,
    sizes: tuple[int, int],
    rng: np.random.Generator,
) -> Scene:
    """Choose the samples that take part and precompute the sky's transport.

    `sizes` are the numbers of samples and of soft lobes; rays start at `offset` above the surface.
    """
    num_rows, num_soft = sizes
    surfels = transport.surfels
    soft = soft_transfer(transport.visibility, surfels, num_soft)
    seen = np.flatnonzero((transport.observations.weight > 0).sum(1) >= 2)
    rows = np.sort(rng.choice(seen, min(num_rows, len(seen)), replace=False))
    pairs = neighbour_pairs(surfels, rows, PAIR_REACHES, _NUM_PARTNERS, rng)
    return Scene(transport, tracer, soft, offset, rows, pairs)


def blocks_of(scene: Scene) -> NDArray[np.int64]:
    """Block number of the first sample of every ordered pair, (2 P,)."""
    block = block_numbers(scene.transport.surfels.position[scene.rows])
    return np.concatenate([block[scene.pairs.first.numpy()], block[scene.pairs.second.numpy()]])


@dataclass(frozen=True, slots=True, kw_only=True)
class Problem:
    """A scene under one tone curve."""

    scene: Scene
    curve: AbstractToneCurve  # the tone curve
    gains: Gains  # how each photograph was exposed, under this curve
    linear: Tensor  # (S, V, 3) radiance of every observation, at the common exposure
    radiance: Radiance  # (S) diffuse radiance of all samples
    exitant: Tensor  # (S, 3) radiance that leaves all samples; estimated for the hidden ones
    indirect: Tensor  # (S, 3) irradiance of all samples from other surfaces

    def without_highlights(self, diffuse: Tensor) -> Problem:
        """The problem once the radiance (S, V, 3) without its specular part is known."""
        radiance = diffuse_radiance(self.scene.transport.observations, diffuse)
        return replace(self, radiance=radiance)

    def by_every_sample(self, rng: np.random.Generator) -> Problem:
        """The problem in which every sample takes part that two views see."""
        return self.by_samples(np.flatnonzero(self.radiance.seen), rng)

    def by_samples(self, rows: NDArray[np.int64], rng: np.random.Generator) -> Problem:
        """The problem in which these samples (U,) take part; `rng` is the source of neighbours."""
        surfels = self.scene.transport.surfels
        pairs = neighbour_pairs(surfels, rows, PAIR_REACHES, _EVERY_PARTNERS, rng)
        return replace(self, scene=replace(self.scene, rows=rows, pairs=pairs))

    def rows_radiance(self, rows: NDArray[np.int64]) -> Radiance:
        """Radiance of some samples."""
        return Radiance(
            linear=self.radiance.linear[rows],
            clipped=self.radiance.clipped[rows],
            seen=self.radiance.seen[rows],
        )

    def transfer(self, sharp: Tensor, rows: NDArray[np.int64]) -> Transfer:
        """Transfer of some samples, with given columns for the sharp lobes."""
        return Transfer(soft=self.scene.soft[rows], sharp=sharp, indirect=self.indirect[rows])


def make_problem(scene: Scene, curve: AbstractToneCurve) -> Problem:
    """Undo a tone curve and gather what it makes known, highlights included."""
    observations = scene.transport.observations
    gains = Gains({}) if scene.exposures is None else scene.exposures.gains(curve)
    linear = linear_observations(observations, curve, gains, scene.transport.surfels.normal)
    total = diffuse_radiance(observations, linear)
    # What bounces is everything that leaves the surface, highlights aside.
    exitant = with_hidden(scene, total)
    indirect = scene.bounced(exitant)
    return Problem(
        scene=scene,
        curve=curve,
        gains=gains,
        linear=linear,
        radiance=total,
        exitant=exitant,
        indirect=indirect,
    )


def with_hidden(scene: Scene, total: Radiance) -> Tensor:
    """Radiance (S, 3) of all samples, of those that no camera sees by what reaches them.

    Hidden ones are darker the less sky they see; a little comes from each other and from what is
    seen, by the albedo of what lies about them.
    """
    exitant, hidden = total.linear.clone(), ~total.seen
    if not hidden.any() or hidden.all():
        return exitant
    open_sky = scene.soft.sum(1)
    openness = (open_sky / open_sky.quantile(0.99)).clamp(max=1.0)[hidden, None]
    median = exitant[total.seen].median(0).values
    albedo = _hidden_albedo(scene, total, median)
    sky = _SKY_SHARE * median * openness * albedo / MEAN_ALBEDO
    exitant[hidden] = sky
    for _ in range(_NUM_BOUNCES):
        exitant[hidden] = sky + albedo / np.pi * scene.bounced(exitant)[hidden]
    return exitant


def _hidden_albedo(scene: Scene, total: Radiance, median: Tensor) -> Tensor:
    """Albedo (H, 3) of hidden samples by brighter seen ones; `median` (3,) has `MEAN_ALBEDO`."""
    position, seen = scene.transport.surfels.position, total.seen.numpy()
    count = min(_LOOK_ALIKES, int(seen.sum()))
    tree = cKDTree(position[seen])
    around = tree.query(position[~seen], k=count, workers=num_workers())[1].reshape(-1, count)
    shown = total.linear.numpy()[seen][around]
    bright = np.quantile(shown, _LOOK_ALIKE_RANK, axis=1)
    relative = torch.from_numpy(bright).float() / median.clamp(min=1e-6)
    return (MEAN_ALBEDO * relative).clamp(_LEAST_HIDDEN_ALBEDO, _MOST_HIDDEN_ALBEDO)
