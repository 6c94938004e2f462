# SPDX-License-Identifier: Apache-2.0
"""Reflection against quadrature over the hemisphere, reciprocity and energy."""

import math

import pytest
import torch

from robir.maths import microfacet, vectors

ROUGHNESS = [0.2, 0.4, 0.7, 1.0]
UP = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)


def view_at(cosine: float) -> torch.Tensor:
    return torch.tensor([math.sqrt(1.0 - cosine * cosine), 0.0, cosine], dtype=torch.float64)


@pytest.fixture(scope="module")
def hemisphere():
    sphere = vectors.fibonacci_sphere(100_000, dtype=torch.float64)
    return sphere[sphere[:, 2] > 0], 4 * math.pi / sphere.shape[0]


def reflectance(hemisphere, cosine: float, roughness: float, f0: float) -> float:
    directions, angle = hemisphere
    value = microfacet.specular_brdf(
        directions,
        view_at(cosine).expand_as(directions),
        UP.expand_as(directions),
        torch.tensor(roughness, dtype=torch.float64),
        torch.tensor([f0], dtype=torch.float64),
    )
    return float((value[:, 0] * directions[:, 2]).sum() * angle)


@pytest.mark.parametrize("roughness", [0.05, *ROUGHNESS])
def test_distribution_projects_to_one(roughness):
    """The integral of D n.h, by Gauss-Legendre in tan^2 of the angle mapped to 0..1."""
    alpha = max(roughness**2, 1e-3)
    # Substituting t = tan^2 = a^2 s / (1 - s) flattens the integrand.
    s = (torch.arange(4000, dtype=torch.float64) + 0.5) / 4000
    tangent = alpha**2 * s / (1 - s)
    cosine = (1 + tangent).rsqrt()
    slope = alpha**2 / (1 - s) ** 2
    density = microfacet.ggx_distribution(cosine, torch.tensor(roughness, dtype=torch.float64))
    # d omega = 2 pi sin dtheta = pi cos^3 dt, times the cosine.
    total = (density * cosine**4 * math.pi * slope).mean()
    assert total.item() == pytest.approx(1.0, abs=1e-6)


def test_reciprocity():
    generator = torch.Generator().manual_seed(0)
    options = {"generator": generator, "dtype": torch.float64}
    light = vectors.normalise(torch.randn(500, 3, **options).abs())
    view = vectors.normalise(torch.randn(500, 3, **options).abs())
    roughness, f0 = torch.rand(500, **options), torch.rand(500, 3, **options)
    normal = UP.expand(500, 3)
    forth = microfacet.specular_brdf(light, view, normal, roughness, f0)
    back = microfacet.specular_brdf(view, light, normal, roughness, f0)
    assert torch.allclose(forth, back, rtol=1e-9)
    assert (forth > 0).all()
    assert (microfacet.specular_brdf(-light, view, normal, roughness, f0) == 0).all()


@pytest.mark.parametrize("roughness", ROUGHNESS)
@pytest.mark.parametrize("cosine", [0.15, 0.5, 1.0])
def test_white_furnace_and_split_sum(hemisphere, roughness, cosine):
    white = reflectance(hemisphere, cosine, roughness, 1.0)
    bias = reflectance(hemisphere, cosine, roughness, 0.0)
    assert white <= 1.0005
    scale, shift = microfacet.environment_brdf(
        torch.tensor(cosine, dtype=torch.float64), torch.tensor(roughness, dtype=torch.float64)
    )
    assert scale.item() == pytest.approx(white - bias, abs=3e-3)
    assert shift.item() == pytest.approx(bias, abs=3e-3)


def test_monte_carlo_agrees_with_split_sum():
    """Uniform directions, 4 sigma."""
    generator = torch.Generator().manual_seed(1)
    directions = vectors.normalise(torch.randn(40_000, 3, generator=generator, dtype=torch.float64))
    directions[:, 2] = directions[:, 2].abs()
    roughness, f0 = torch.tensor(0.6, dtype=torch.float64), 0.04
    value = microfacet.specular_brdf(
        directions,
        view_at(0.6).expand_as(directions),
        UP.expand_as(directions),
        roughness,
        torch.tensor([f0], dtype=torch.float64),
    )
    samples = value[:, 0] * directions[:, 2] * 2 * math.pi
    scale, bias = microfacet.environment_brdf(torch.tensor(0.6, dtype=torch.float64), roughness)
    error = samples.mean() - (f0 * scale + bias)
    assert abs(error / (samples.std() / math.sqrt(len(samples)))) < 4.0


def test_smooth_surface_is_a_mirror_without_overflow():
    roughness = torch.tensor(0.0)
    normal, view = UP.float(), view_at(0.7).float()
    mirror = vectors.reflect(view, normal)
    value = microfacet.specular_brdf(mirror, view, normal, roughness, torch.tensor([0.04]))
    assert value.isfinite().all()
    assert value > 1e3
    scale, bias = microfacet.environment_brdf(torch.tensor(0.7), roughness)
    assert (scale + bias).item() == pytest.approx(1.0, abs=1e-3)
