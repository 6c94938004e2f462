# SPDX-License-Identifier: Apache-2.0
"""Regularisers, start of the light and tone curves against closed forms."""

from __future__ import annotations

import math

import pytest
import torch

from robir.maths.spherical_gaussian import integral
from robir.maths.tone import AcesToneCurve
from robir_bench.paper import losses
from robir_bench.paper.light import EnvironmentLight
from robir_bench.paper.tone import AcesTone


def coin_divergence(p: float, q: float) -> float:
    return p * math.log(p / q) + (1 - p) * math.log((1 - p) / (1 - q))


@pytest.mark.parametrize("mean", [0.02, 0.05, 0.3, 0.9])
def test_sparsity_is_the_divergence_of_two_coins(mean):
    code = torch.full((8, 4), mean) + torch.tensor([0.01, -0.01]).repeat(4)[:, None]
    found = losses.sparsity_loss(code).item()
    assert found == pytest.approx(coin_divergence(0.05, mean), abs=2e-3)


def test_the_edge_loss_wants_a_mean_residual_of_a_hundredth():
    given = torch.zeros(100, 1)
    few_large = torch.zeros(100, 1)
    few_large[0] = 1.0
    many_small = torch.full((100, 1), 0.01)
    assert losses.edge_loss(few_large, given).item() == pytest.approx(0.0, abs=1e-6)
    assert losses.edge_loss(many_small, given).item() == pytest.approx(0.0, abs=1e-6)
    found = losses.edge_loss(torch.full((100, 1), -0.2), given).item()
    assert found == pytest.approx(coin_divergence(0.01, 0.2), abs=1e-3)


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
