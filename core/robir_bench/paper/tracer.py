# SPDX-License-Identifier: Apache-2.0
"""Rays against a distance network: sphere tracing through its values on a lattice.

RobIR keeps the network's values at the centres of octree cells for the same reason: asking the
network at every step of every ray is out of the question. Batch letter: R rays.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from robir.geometry.lattice import Lattice, Sampled
from robir_bench.paper.networks import SdfNetwork
from robir_bench.paper.neus import SPHERE

_STEPS = 96
# Networks are no exact distances: their slope may exceed 1.
_CAUTION = 0.8
_NEAR = 0.1
_CHUNK = 1 << 16
_PROJECTIONS = 4
_LEAST_SLOPE = 0.2


@torch.no_grad()
def on_lattice(sdf: SdfNetwork, cells: int) -> Sampled:
    """Distances (N,) on a lattice over the unit sphere, outside of which all is empty."""
    corner = np.full(3, SPHERE)
    lattice = Lattice.around(-corner, corner, cells, margin=0)
    nodes = lattice.nodes()
    values = torch.cat([sdf(part)[:, 0] for part in nodes.split(_CHUNK)])
    return Sampled(lattice, torch.maximum(values, nodes.norm(dim=1) - SPHERE + lattice.cell))


@dataclass(frozen=True, slots=True, kw_only=True)
class FieldTracer:
    """Traces a field known at nodes, to first order about the nearest node."""

    lattice: Lattice  # nodes
    values: Tensor  # (N,), distances
    gradient: Tensor  # (N, 3)

    @classmethod
    def of(cls, lattice: Lattice, values: Tensor) -> FieldTracer:
        """Tracer of distances (N,) at nodes."""
        grid = values.view(lattice.shape).numpy()
        slopes = np.stack(np.gradient(grid, lattice.cell), axis=-1).reshape(-1, 3)
        gradient = torch.from_numpy(slopes.astype(np.float32))
        return cls(lattice=lattice, values=values, gradient=gradient)

    def distance(self, points: Tensor) -> Tensor:
        """Distances (R,) at points (R, 3) inside the lattice."""
        return self._about(points)[0]

    def onto_surface(self, points: Tensor) -> Tensor:
        """Points (R, 3) of the field next to points near it, by Newton's steps along its gradient.

        A mesh is smoothed and decimated; networks with fast sines know only where rays end.
        """
        for _ in range(_PROJECTIONS):
            value, gradient = self._about(points)
            steepness = (gradient**2).sum(dim=1).clamp_min(_LEAST_SLOPE**2)
            step = (-value / steepness)[:, None] * gradient
            longest = step.norm(dim=1, keepdim=True).clamp_min(1e-9)
            points = points + step * (self.lattice.cell / longest).clamp(max=1.0)
        return points

    def _about(self, points: Tensor) -> tuple[Tensor, Tensor]:
        """Distance and gradient at points, to first order about the nearest node."""
        node = self.lattice.nearest(points)
        _, ny, nz = self.lattice.shape
        index = torch.stack([node // (ny * nz), node // nz % ny, node % nz], dim=1)
        centre = points.new_tensor(self.lattice.lower) + self.lattice.cell * index
        gradient = self.gradient[node]
        return self.values[node] + ((points - centre) * gradient).sum(dim=1), gradient

    @torch.no_grad()
    def first_hits(self, origins: Tensor, directions: Tensor) -> Tensor:
        """Distance (R,) to the first surface, inf where a ray leaves the sphere.

        Rays that still creep along a surface after all steps have missed it. RobIR's programs
        count them as blocked, which darkens what lies flat to the light.
        """
        middle = -(origins * directions).sum(dim=1)
        beside = (origins**2).sum(dim=1) - middle**2
        half = (SPHERE**2 - beside).clamp_min(0.0).sqrt()
        travelled, end = (middle - half).clamp_min(0.0), middle + half
        found = torch.full_like(travelled, torch.inf)
        alive = torch.nonzero((half > 0.0) & (end > 0.0))[:, 0]
        for _ in range(_STEPS):
            if len(alive) == 0:
                break
            points = origins[alive] + travelled[alive, None] * directions[alive]
            gap = self.distance(points)
            reached = gap < _NEAR * self.lattice.cell
            found[alive[reached]] = travelled[alive[reached]] + gap[reached]
            step = _CAUTION * gap.clamp_min(2.0 * _NEAR * self.lattice.cell)
            travelled[alive] += step
            alive = alive[~reached & (travelled[alive] < end[alive])]
        return found
