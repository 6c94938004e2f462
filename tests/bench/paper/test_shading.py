# SPDX-License-Identifier: Apache-2.0
"""Rendering in lobes against quadrature of what the lobes stand for."""

from __future__ import annotations

import math

import pytest
import torch

from robir.maths.spherical_gaussian import SphericalGaussians, lobe_shapes
from robir.maths.vectors import dot, fibonacci_sphere, normalise
from robir_bench.paper import shading

DIRECTIONS = fibonacci_sphere(200_000, dtype=torch.float64)
SOLID_ANGLE = 4.0 * math.pi / len(DIRECTIONS)
NORMAL = torch.tensor([[0.0, 0.0, 1.0]], dtype=torch.float64)
F0 = torch.tensor(0.05, dtype=torch.float64)


def tilted(degrees: float, azimuth: float = 0.0) -> torch.Tensor:
    a, b = math.radians(degrees), math.radians(azimuth)
    axis = [math.sin(a) * math.cos(b), math.sin(a) * math.sin(b), math.cos(a)]
    return torch.tensor([axis], dtype=torch.float64)


def sharp(value: float) -> torch.Tensor:
    return torch.tensor([value], dtype=torch.float64)


@pytest.mark.parametrize("sharpness", [2.0, 20.0, 150.0])
@pytest.mark.parametrize("degrees", [0.0, 50.0, 88.0, 110.0])
def test_irradiance_of_a_lobe_is_its_integral_with_the_cosine(sharpness, degrees):
    axis = tilted(degrees)
    lobe = torch.exp(sharpness * (DIRECTIONS @ axis[0] - 1.0))
    cosine = (DIRECTIONS @ NORMAL[0]).clamp_min(0.0)
    truth = (lobe * cosine).sum() * SOLID_ANGLE
    found = shading.diffuse_transfer(axis, sharp(sharpness), NORMAL)
    assert found.item() == pytest.approx(truth.item(), abs=0.009 * 2.0 * math.pi / sharpness)


def brdf(light, view, roughness):
    """The same microfacet formula, evaluated at every light direction; (D,)."""
    half = normalise(light + view)
    cosine_light, cosine_view = light @ NORMAL[0], (view @ NORMAL[0]).item()
    fourth = roughness**4
    spread = torch.exp(2.0 / fourth * (half @ NORMAL[0] - 1.0)) / (math.pi * fourth)
    x = dot(half, view.expand_as(half))
    fresnel = 0.05 + 0.95 * 2.0 ** (-(5.55473 * x + 6.8316) * x)
    k = (roughness + 1.0) ** 2 / 8.0
    shadowing = 1.0
    for cosine in (cosine_light, torch.tensor(cosine_view)):
        shadowing = shadowing * cosine / (cosine * (1.0 - k) + k)
    lit = cosine_light > 1e-3
    value = spread * fresnel * shadowing / (4.0 * cosine_light.clamp_min(1e-3) * cosine_view)
    return torch.where(lit, value, torch.zeros_like(value))


@pytest.mark.parametrize(("roughness", "tolerance"), [(0.3, 0.05), (0.5, 0.12)])
@pytest.mark.parametrize("view_degrees", [0.0, 40.0])
def test_the_reflection_of_a_lobe_is_the_integral_with_the_brdf(roughness, tolerance, view_degrees):
    view, axis = tilted(view_degrees), tilted(view_degrees, 180.0)
    lobe = torch.exp(20.0 * (DIRECTIONS @ axis[0] - 1.0))
    cosine = (DIRECTIONS @ NORMAL[0]).clamp_min(0.0)
    truth = (lobe * brdf(DIRECTIONS, view[0], roughness) * cosine).sum() * SOLID_ANGLE
    found = shading.specular_transfer(axis, sharp(20.0), (NORMAL, view), sharp(roughness), F0)
    assert found.item() == pytest.approx(truth.item(), rel=tolerance)


@pytest.mark.parametrize(("sharpness", "beyond", "share"), [(10, 5, 0.395), (30, 5, 0.318)])
def test_the_ratio_behind_a_straight_edge_is_the_exact_one(sharpness, beyond, share):
    """An edge whose shadow holds the lobe's axis; RobIR's sampler gives .258 and .161."""
    directions = fibonacci_sphere(4096, dtype=torch.float64)
    light = SphericalGaussians(NORMAL, sharp(float(sharpness)), torch.ones(1, 3).double())
    angle = math.radians(beyond)
    edge = torch.tensor([math.cos(angle), 0.0, -math.sin(angle)], dtype=torch.float64)
    free = (directions @ edge > 0.0).double()[None]
    found = shading.visibility_ratio(light, directions, free)
    assert found.item() == pytest.approx(share, abs=0.01)
    shape = lobe_shapes(light, directions)[:, 0]
    assert found.item() == pytest.approx((shape * free[0]).sum().item() / shape.sum().item())
