# SPDX-License-Identifier: Apache-2.0
"""Lobes against quadrature over the sphere and against closed forms."""

import itertools
import math

import numpy as np
import pytest
import torch

from robir.maths import spherical_gaussian as sg
from robir.maths import vectors


def random_lobes(count: int, seed: int, sharpest: float = 60.0) -> sg.SphericalGaussians:
    generator = torch.Generator().manual_seed(seed)
    options = {"generator": generator, "dtype": torch.float64}
    axis = vectors.normalise(torch.randn(count, 3, **options))
    sharpness = 0.3 + (sharpest - 0.3) * torch.rand(count, **options)
    return sg.SphericalGaussians(axis, sharpness, torch.rand(count, 3, **options))


@pytest.fixture(scope="module")
def sphere():
    directions = vectors.fibonacci_sphere(60_000, dtype=torch.float64)
    return directions, 4 * math.pi / directions.shape[0]


def share_by_quadrature(sharpness: float, cosine: float) -> float:
    """Irradiance share: Gauss-Legendre over the polar angle, the azimuth in closed form."""
    lowest = max(-1.0, 1.0 - 40.0 / sharpness)
    sine = math.sqrt(max(0.0, 1.0 - cosine * cosine))
    # The integrand bends where the lobe's circle touches the horizon.
    edges = sorted({lowest, 1.0, *(x for x in (-sine, sine) if lowest < x < 1.0)})
    node, weight = np.polynomial.legendre.leggauss(64)
    total = 0.0
    for low, high in itertools.pairwise(edges):
        u = low + 0.5 * (high - low) * (node + 1.0)
        along, across = u * cosine, np.sqrt(1.0 - u * u) * sine
        angle = np.arccos(np.clip(-along / np.maximum(across, 1e-300), -1.0, 1.0))
        mean = (along * angle + across * np.sin(angle)) / np.pi
        density = sharpness * np.exp(sharpness * (u - 1.0)) / -np.expm1(-2.0 * sharpness)
        total += 0.5 * (high - low) * float((weight * density * mean).sum())
    return total


def test_product_is_the_pointwise_product(sphere):
    directions = sphere[0][::50]
    first, second = random_lobes(6, 0), random_lobes(6, 1)
    both = sg.product(first, second)
    left = sg.lobe_shapes(both, directions)[..., None] * both.amplitude
    right = (
        sg.lobe_shapes(first, directions)[..., None]
        * sg.lobe_shapes(second, directions)[..., None]
        * first.amplitude
        * second.amplitude
    )
    assert torch.allclose(left, right, atol=1e-13)


def test_product_of_sharp_lobes_in_float32_keeps_its_digits():
    axis = vectors.normalise(torch.tensor([[1.0, 2.0, 3.0]]))
    lobe = sg.SphericalGaussians(axis, torch.tensor([1e5]), torch.ones(1, 1))
    same = sg.product(lobe, lobe)
    assert same.amplitude.item() == pytest.approx(1.0, rel=1e-3)
    assert same.sharpness.item() == pytest.approx(2e5, rel=1e-5)
    opposite = sg.product(lobe, sg.SphericalGaussians(-axis, lobe.sharpness, lobe.amplitude))
    assert opposite.amplitude.item() == 0.0
    assert opposite.axis.isfinite().all()


def test_integral_matches_quadrature_and_adds_up(sphere):
    directions, angle = sphere
    lobes = random_lobes(5, 2)
    of_sum = sg.evaluate(lobes, directions).sum(0) * angle
    assert torch.allclose(of_sum, sg.integral(lobes).sum(0), rtol=1e-5)


@pytest.mark.parametrize("sharpness", [0.5, 1.0, 2.0, 3.0, 5.0, 10.0, 30.0, 300.0, 1e4, 1e5])
def test_irradiance_share_matches_quadrature(sharpness):
    cosine = torch.linspace(-1.0, 1.0, 41, dtype=torch.float64)
    share = sg.cosine_shares(torch.tensor(sharpness, dtype=torch.float64), cosine)
    truth = torch.tensor([share_by_quadrature(sharpness, c.item()) for c in cosine])
    assert (share - truth).abs().max() < 0.008
    single = sg.cosine_shares(torch.tensor(sharpness), cosine.float())
    assert (single - share).abs().max() < 1e-4


def test_irradiance_matches_sphere_quadrature(sphere):
    directions, angle = sphere
    lobes = random_lobes(5, 4)
    normal = vectors.normalise(torch.randn(6, 3, dtype=torch.float64))
    clamped = (normal @ directions.T).clamp_min(0.0)
    truth = clamped @ sg.lobe_shapes(lobes, directions) * angle
    found = sg.irradiance(lobes, normal)
    assert ((found - truth[..., None] * lobes.amplitude) / sg.integral(lobes)).abs().max() < 0.008


def test_irradiance_of_both_faces_obeys_the_mean_direction():
    """For max(t, 0) - max(-t, 0) = t, front minus back is the mean cosine, exactly."""
    sharpness = torch.tensor([0.01, 0.7, 20.0, 1e5], dtype=torch.float64)
    cosine = torch.tensor(0.3, dtype=torch.float64)
    difference = sg.cosine_shares(sharpness, cosine) - sg.cosine_shares(sharpness, -cosine)
    assert torch.allclose(difference, 0.3 * sg.mean_cosine(sharpness), atol=1e-9)


def test_irradiance_share_has_gradients():
    sharpness = torch.tensor([0.5, 8.0, 400.0], dtype=torch.float64, requires_grad=True)
    cosine = torch.tensor([0.9, -0.2, 0.01], dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(sg.cosine_shares, (sharpness, cosine))


def test_map_shows_the_lobe_where_it_is():
    lobe = sg.SphericalGaussians(
        torch.tensor([[0.0, 1.0, 0.0]]), torch.tensor([1e5]), torch.ones(1, 1)
    )
    brightest = sg.to_equirect(lobe, 32)[..., 0].argmax().item()
    assert brightest // 64 in (15, 16)
    assert brightest % 64 in (15, 16)
    wide = random_lobes(3, 5, sharpest=10.0)
    image = sg.to_equirect(wide, 32)
    directions = vectors.equirect_directions(32, dtype=torch.float64)
    assert torch.allclose(image, sg.evaluate(wide, directions), rtol=5e-3)
