# SPDX-License-Identifier: Apache-2.0
"""Norm and Vis: smooth normals, visibility and indirect light, learnt from the fitted field.

Batch letters: P points, D directions of each.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn.functional import cross_entropy

from robir.geometry.mesh.triangles import Mesh
from robir.maths.spherical_gaussian import SphericalGaussians, evaluate
from robir.maths.vectors import dot, normalise
from robir.transport.surfels import interpolate
from robir_bench.paper.config import PaperConfig
from robir_bench.paper.networks import IndirectNetwork, NormalNetwork, VisibilityNetwork
from robir_bench.paper.neus import Neus, PhotoRays
from robir_bench.paper.tone import AbstractTone, gamma_of
from robir_bench.paper.tracer import FieldTracer

# standard deviation of what is added to encoded positions where normals shall be smooth
ENCODING_NOISE = 0.02


@dataclass(frozen=True, slots=True, kw_only=True)
class TransportNetworks:
    """What the light does at a point."""

    normals: NormalNetwork  # smooth normals
    visibility: VisibilityNetwork  # of the environment
    indirect: IndirectNetwork  # light of other surfaces

    @classmethod
    def start(cls, config: PaperConfig) -> TransportNetworks:
        """Untrained."""
        return cls(
            normals=NormalNetwork(config.normals.width, config.code_length),
            visibility=VisibilityNetwork(config.visibility.width),
            indirect=IndirectNetwork(config.visibility.indirect_width, config.indirect_lobes),
        )

    def modules(self) -> dict[str, nn.Module]:
        """Networks by name."""
        return {
            "normals": self.normals,
            "visibility": self.visibility,
            "indirect": self.indirect,
        }


def fit_normals(network: NormalNetwork, mesh: Mesh, config: PaperConfig, seed: int) -> None:
    """Teach the normals of a mesh, then make them smooth (RobIR Eq. 3, as the programs have it)."""
    rng, generator = np.random.default_rng(seed), torch.Generator().manual_seed(seed)
    corners = mesh.vertices[mesh.faces].astype(np.float64)
    doubled = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(doubled, axis=1)
    adam = torch.optim.Adam(network.parameters(), lr=config.learning_rate)
    for step in range(config.normals.iterations):
        face = rng.choice(len(area), size=config.normals.points, p=area / area.sum())
        share = rng.dirichlet(np.ones(3), size=len(face)).astype(np.float32)
        position, normal = interpolate(mesh, face.astype(np.int32), share)
        encoded = network.encode(torch.from_numpy(position))
        found = network.from_encoded(encoded)
        loss = ((found - torch.from_numpy(normal)) ** 2).sum(dim=1).mean()
        if step >= config.normals.smooth_after:
            noise = ENCODING_NOISE * torch.randn(encoded.shape, generator=generator)
            loss = loss + (found - network.from_encoded(encoded + noise)).abs().sum(dim=1).mean()
        adam.zero_grad(set_to_none=True)
        loss.backward()
        adam.step()


@dataclass(frozen=True, slots=True, kw_only=True)
class SeenPoints:
    """Surface points that pixels show."""

    points: Tensor  # (P, 3)
    normals: Tensor  # (P, 3), unit
    to_camera: Tensor  # (P, 3), unit
    display: Tensor  # (P, 3), codes in [0, 1]

    def rows(self, index: Tensor | slice) -> SeenPoints:
        """Some of the points."""
        return SeenPoints(
            points=self.points[index],
            normals=self.normals[index],
            to_camera=self.to_camera[index],
            display=self.display[index],
        )


@torch.no_grad()
def surface_hits(
    rays: tuple[Tensor, Tensor], display: Tensor, tracer: FieldTracer, normals: NormalNetwork
) -> tuple[SeenPoints, Tensor]:
    """Where rays of pixels meet the field.

    Args:
        rays: Origins and unit directions (R, 3).
        display: Codes (R, 3) of the pixels, in [0, 1].
        tracer: Of the field.
        normals: Smooth normals.

    Returns:
        The points, and which rays (R,) met any.
    """
    origins, directions = rays
    distance = tracer.first_hits(origins, directions)
    met = torch.isfinite(distance)
    points = origins[met] + distance[met, None] * directions[met]
    hits = SeenPoints(
        points=points,
        normals=normals(points),
        to_camera=-directions[met],
        display=display[met],
    )
    return hits, met


def random_hits(
    pixels: PhotoRays,
    count: int,
    tracer: FieldTracer,
    normals: NormalNetwork,
    generator: torch.Generator,
) -> SeenPoints:
    """Points of random pixels inside the masks; those that miss the field are left out."""
    drawn = torch.randint(len(pixels.inside), (count,), generator=generator)
    chosen = pixels.inside[drawn]
    return surface_hits(pixels.rays(chosen), pixels.targets(chosen)[0], tracer, normals)[0]


def fit_visibility(
    networks: TransportNetworks,
    scene: tuple[Neus, FieldTracer, PhotoRays],
    tone: AbstractTone,
    config: PaperConfig,
    generator: torch.Generator,
) -> None:
    """Teach visibility and indirect light by rays from random pixels' points.

    Args:
        networks: Normals taught already.
        scene: Field, its tracer and the photographs' pixels.
        tone: Curve whose radiance is wanted; every step draws one of its family.
        config: The schedule.
        generator: Of pixels, directions and curves.
    """
    field, tracer, pixels = scene
    schedule = config.visibility
    rate = config.learning_rate
    visible_adam = torch.optim.Adam(networks.visibility.parameters(), lr=rate)
    indirect_adam = torch.optim.Adam(networks.indirect.parameters(), lr=rate)
    for _ in range(schedule.iterations):
        hits = random_hits(pixels, schedule.pixels, tracer, networks.normals, generator)
        shape = (len(hits.points), schedule.directions, 3)
        directions = normalise(torch.randn(shape, generator=generator))
        distance = secondary_distances(tracer, hits, directions, schedule.offset)
        is_free = ~torch.isfinite(distance)
        logits = networks.visibility.logits(hits.points, directions)
        loss = cross_entropy(logits.flatten(0, 1), is_free.flatten().long())
        visible_adam.zero_grad(set_to_none=True)
        loss.backward()
        visible_adam.step()
        counts = ~is_free & (dot(directions, hits.normals[:, None]) > 0.0)
        if not counts.any():
            continue
        curve = tone.random_curve(generator)
        starts = (hits.points + schedule.offset * hits.normals)[:, None].expand(shape)[counts]
        ends = starts + distance[counts][:, None] * directions[counts]
        target = curve.linear_from_display(field.radiance(ends, directions[counts]))
        lobes = networks.indirect(hits.points, gamma_of(curve))
        light = incident(lobes, directions)[counts]
        loss = (light - target).abs().mean()
        indirect_adam.zero_grad(set_to_none=True)
        loss.backward()
        indirect_adam.step()


def secondary_distances(
    tracer: FieldTracer, hits: SeenPoints, directions: Tensor, offset: float
) -> Tensor:
    """Distance (P, D) from just above each point to the next surface along (P, D, 3), or inf."""
    starts = (hits.points + offset * hits.normals)[:, None].expand_as(directions)
    found = tracer.first_hits(starts.reshape(-1, 3), directions.reshape(-1, 3))
    return found.view(directions.shape[:2])


def incident(lobes: SphericalGaussians, directions: Tensor) -> Tensor:
    """Radiance (P, D, 3) of each point's own lobes along its directions (P, D, 3)."""
    shaped = SphericalGaussians(lobes.axis, lobes.sharpness[:, None], lobes.amplitude)
    return evaluate(shaped, directions)
