# SPDX-License-Identifier: Apache-2.0
"""Regularisers, start of the light and tone curves against closed forms."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

from robir.maths.spherical_gaussian import integral
from robir.maths.tone import AcesToneCurve
from robir_bench.paper import losses
from robir_bench.paper.config import PaperConfig, published, published_truck, shrunken
from robir_bench.paper.light import EnvironmentLight
from robir_bench.paper.networks import MaterialNetwork
from robir_bench.paper.tone import AcesTone, SrgbTone, gamma_of


def coin_divergence(p: float, q: float) -> float:
    return p * math.log(p / q) + (1 - p) * math.log((1 - p) / (1 - q))


@pytest.mark.parametrize("mean", [0.02, 0.05, 0.3, 0.9])
def test_sparsity_is_the_divergence_of_two_coins(mean):
    code = torch.full((8, 4), mean) + torch.tensor([0.01, -0.01]).repeat(4)[:, None]
    found = losses.sparsity_loss(code).item()
    assert found == pytest.approx(coin_divergence(0.05, mean), abs=2e-3)


def test_sparsity_averages_before_it_judges():
    """Codes that are on for few points each are sparse; those half on for all are not."""
    few = torch.eye(20)
    assert losses.sparsity_loss(few).item() == pytest.approx(0.0, abs=1e-6)
    assert losses.sparsity_loss(torch.full((20, 20), 0.5)).item() > 0.4


def test_the_edge_loss_wants_a_mean_residual_of_a_hundredth():
    given = torch.zeros(100, 1)
    few_large = torch.zeros(100, 1)
    few_large[0] = 1.0
    many_small = torch.full((100, 1), 0.01)
    assert losses.edge_loss(few_large, given).item() == pytest.approx(0.0, abs=1e-6)
    assert losses.edge_loss(many_small, given).item() == pytest.approx(0.0, abs=1e-6)
    found = losses.edge_loss(torch.full((100, 1), -0.2), given).item()
    assert found == pytest.approx(coin_divergence(0.01, 0.2), abs=1e-3)


def test_smoothness_is_nothing_without_noise_and_sees_roughness_less():
    network = MaterialNetwork(16, 8)
    code = network.code(torch.rand(6, 3))
    noise = torch.randn(code.shape)
    assert losses.smoothness_loss(network, code, torch.zeros_like(noise)).item() == 0.0
    albedo, roughness = network.decode(code)
    moved = network.decode(code + 0.01 * noise)
    expected = (albedo - moved[0]).abs().mean() + 0.2 * (roughness - moved[1]).abs().mean()
    assert torch.allclose(losses.smoothness_loss(network, code, noise), expected)


def test_grey_light_is_white_and_red_light_is_not():
    assert losses.whiteness_loss(torch.tensor([[2.0, 2.0, 2.0]])).item() == pytest.approx(0.0)
    found = losses.whiteness_loss(torch.tensor([[3.0, 0.0, 0.0]])).item()
    assert found == pytest.approx(2.0 / 9.0)  # of (1, 0, 0)


def test_the_light_starts_grey_with_its_energy():
    lobes = EnvironmentLight(128, torch.Generator().manual_seed(1)).lobes()
    assert lobes.axis.shape == (128, 3)
    assert torch.allclose(lobes.axis[:64], lobes.axis[64:])
    assert lobes.sharpness.min() >= 10.0
    energy = integral(lobes).sum(dim=0)
    assert torch.allclose(energy, torch.full((3,), 1.6 * math.pi), rtol=1e-5)


def test_robirs_curve_is_the_one_of_maths_before_the_cut():
    tone = AcesTone()
    radiance = torch.linspace(0.0, 1.2, 50)[:, None].expand(-1, 3)
    reference = AcesToneCurve(0.5)
    assert tone.gamma.item() == pytest.approx(0.5, abs=1e-4)
    display = reference.display_from_linear(radiance)
    assert torch.allclose(tone.shown(radiance), tone.decoded(display), atol=1e-5)
    # Beyond white the fit goes on, up to 1.0329 g^-0.2.
    far = tone.shown(torch.full((1, 3), 1e6))
    assert far[0, 0].item() == pytest.approx(2.51 / 2.43 * 0.5**-0.2, rel=1e-4)


def test_the_scalar_keeps_a_gradient_at_its_ends():
    tone = AcesTone()
    for value in (-0.8, 0.8):
        with torch.no_grad():
            next(tone.parameters()).fill_(value)
        tone.zero_grad()
        tone.shown(torch.ones(1, 3)).sum().backward()
        assert next(tone.parameters()).grad.abs() > 0.0


def test_random_curves_cover_the_family_and_srgb_has_one():
    generator = torch.Generator().manual_seed(0)
    gammas = [gamma_of(AcesTone().random_curve(generator)).item() for _ in range(400)]
    assert np.quantile(gammas, [0.1, 0.5, 0.9]) == pytest.approx([0.1, 0.5, 0.9], abs=0.07)
    assert gamma_of(SrgbTone().random_curve(generator)) == 1.0
    codes = torch.rand(5, 3)
    srgb = SrgbTone()
    shown = srgb.curve().display_from_linear(srgb.decoded(codes))
    assert torch.allclose(shown, codes, atol=1e-5)


def test_the_schedules_are_the_published_ones():
    steps = []
    for c in (published(), published_truck()):
        stages = (c.neus, c.normals, c.visibility, c.material, c.refinement)
        steps.append((*(stage.iterations for stage in stages), c.refinement.warm_up))
    assert steps == [(200_000, 10_100, 10_100, 20_100, 10_100, 500)] * 2
    edges = [c.refinement.weights.edge for c in (published(), published_truck(), shrunken())]
    assert edges == [1.0, 0.2, 0.2]
    for c in (published(), shrunken()):
        assert isinstance(c, PaperConfig)
        assert (c.light_lobes, c.indirect_lobes, c.code_length) == (128, 24, 32)
