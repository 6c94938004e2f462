# SPDX-License-Identifier: Apache-2.0
"""Volume rendering, tracing and the targets of visibility against closed forms."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

from robir.geometry.lattice import Lattice
from robir.maths.vectors import dot, fibonacci_sphere
from robir_bench.paper import neus
from robir_bench.paper.tracer import FieldTracer
from robir_bench.paper.transport import Hits, secondary_distances

SMALL = torch.tensor([0.0, 0.0, 0.62])
RADII = (0.4, 0.15)


def two_spheres(points):
    """Distance to a sphere at the origin and a small one above it."""
    large = points.norm(dim=-1) - RADII[0]
    return torch.minimum(large, (points - SMALL).norm(dim=-1) - RADII[1])


@pytest.fixture(scope="module")
def tracer() -> FieldTracer:
    corner = np.full(3, neus.SPHERE)
    lattice = Lattice.around(-corner, corner, 96, margin=0)
    return FieldTracer.of(lattice, two_spheres(lattice.nodes()))


def sphere_hit(origins, directions, centre, radius):
    """Nearest positive distance to a sphere, inf beside it."""
    towards = centre - origins
    along = dot(towards, directions)
    square = radius**2 - (dot(towards, towards) - along**2)
    distance = along - square.clamp_min(0.0).sqrt()
    missed = (square < 0.0) | (distance < 0.0)
    return torch.where(missed, torch.inf, distance)


def test_first_hits_are_those_of_the_spheres(tracer):
    origins = 2.5 * fibonacci_sphere(3000)
    directions = torch.nn.functional.normalize(0.45 * torch.randn(3000, 3) - origins, dim=1)
    found = tracer.first_hits(origins, directions)
    truth = torch.minimum(
        sphere_hit(origins, directions, torch.zeros(3), RADII[0]),
        sphere_hit(origins, directions, SMALL, RADII[1]),
    )
    same = torch.isfinite(found) == torch.isfinite(truth)
    assert same.float().mean() > 0.985  # rays that graze are anyone's
    both = torch.isfinite(found) & torch.isfinite(truth)
    error = (found - truth)[both].abs()
    assert error.median() < 0.1 * tracer.lattice.cell
    assert error.quantile(0.98) < tracer.lattice.cell


def test_the_target_of_visibility_is_what_brute_force_sees(tracer):
    normals = fibonacci_sphere(80)
    normals = normals[normals[:, 2] > -0.5]
    points = RADII[0] * normals
    hits = Hits(points=points, normals=normals, to_camera=normals, display=normals)
    directions = fibonacci_sphere(300).expand(len(points), -1, -1)
    found = torch.isfinite(secondary_distances(tracer, hits, directions, 0.02))
    at = torch.linspace(0.03, 2.0, 500)
    blocked = torch.zeros_like(found)
    for row in range(len(points)):
        start = points[row] + 0.02 * normals[row]
        along = start + at[:, None, None] * directions[row]
        blocked[row] = (two_spheres(along) < 0.0).any(dim=0)
    assert (found == blocked).float().mean() > 0.985
    above = dot(directions, normals[:, None]) > 0.1
    assert (found == blocked)[above].float().mean() > 0.995
    assert 0.02 < blocked[above].float().mean() < 0.5  # the small sphere does hide some sky


def test_weights_add_up_to_the_closed_form():
    """A ray through a slab: what passes is the product of ratios of the logistic function."""
    distance = torch.linspace(-0.4, 0.4, 60).double()
    sdf = torch.cat([-distance, distance[1:]])[None]  # falls to -0.4, then rises
    steepness = 20.0
    weight = neus._weights(sdf, steepness)

    def logistic(value: float) -> float:
        return 1.0 / (1.0 + math.exp(-steepness * value))

    passed = logistic(-0.4) / logistic(0.4)
    assert weight.sum().item() == pytest.approx(1.0 - passed, rel=1e-9)
    assert (weight[0, 59:] == 0.0).all()
    # The maximum lies at the surface, unbiased (NeuS Sec. 3.1).
    middle = 0.5 * (sdf[0, :59] + sdf[0, 1:60])
    steep = neus._weights(sdf, 80.0)[0, :59]
    assert abs(middle[steep.argmax()].item()) < 0.015
