# SPDX-License-Identifier: Apache-2.0
"""Pairs of one hue, and the shading of a smooth thing that only they see."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from robir.appearance.light.lobes import (
    Priors,
    Transfer,
    far_pairs,
    log_ratio,
    soft_lobes,
    solve_amplitudes,
)
from robir.appearance.light.solver import _FAR
from robir.appearance.photometry.statistics import Pairs, Radiance, neighbour_pairs
from robir.maths.vectors import fibonacci_sphere
from robir.transport.surfels import Surfels

RED, GREEN = torch.tensor([0.6, 0.2, 0.1]), torch.tensor([0.1, 0.4, 0.1])


def test_pairs_join_what_is_of_one_hue_however_bright_it_is():
    red = torch.arange(400) % 2 == 0
    paint = torch.where(red[:, None], RED, GREEN) * torch.linspace(0.3, 1.0, 400)[:, None]
    pairs = far_pairs(paint.log(), torch.arange(400))
    assert pairs is not None
    assert float(pairs.weight.sum()) == pytest.approx(1)
    alike = red[pairs.first] == red[pairs.second]
    assert float(pairs.weight[alike].sum()) > 0.999
    # in eight draws of an eighth, a sample rarely has one partner throughout
    assert len({(int(a), int(b)) for a, b in zip(pairs.first, pairs.second, strict=True)}) > 800


def test_only_what_is_not_clipped_takes_part():
    whole = torch.arange(100, 300)
    pairs = far_pairs(torch.rand(400, 3), whole)
    assert pairs is not None
    assert set(pairs.first.tolist()) | set(pairs.second.tolist()) <= set(whole.tolist())
    assert far_pairs(torch.rand(400, 3), whole[:119]) is None


def _ball() -> tuple[Surfels, Transfer]:
    """An unpainted ball that nothing shades, under 24 lobes."""
    points = fibonacci_sphere(1500).numpy().astype(np.float32)
    axes, sharpness = soft_lobes(24)
    directions = fibonacci_sphere(1024).float()
    lobes = torch.exp(sharpness * (directions @ axes.T - 1)) * (4 * np.pi / 1024)
    soft = (torch.from_numpy(points) @ directions.T).clamp(min=0) @ lobes
    surfels = Surfels(position=points, normal=points, spacing=0.05)
    nothing = torch.zeros(len(points), 0)
    return surfels, Transfer(soft=soft, sharp=nothing, indirect=torch.zeros(len(points), 3))


def test_the_shading_of_a_plain_ball_leaves_its_albedo():
    surfels, transfer = _ball()
    axes, _ = soft_lobes(24)
    true = (0.2 + (axes[:, 2:] + 1) ** 2) * torch.tensor([1.0, 1.0, 1.1])
    radiance = Radiance(
        linear=transfer.soft @ true * torch.tensor([0.5, 0.3, 0.2]) / np.pi,
        clipped=torch.zeros(1500, 3, dtype=torch.bool),
        seen=torch.ones(1500, dtype=torch.bool),
    )
    near = neighbour_pairs(
        surfels, np.arange(1500), (0.05, 0.12, 0.25), 6, np.random.default_rng(0)
    )
    spread = {}
    for far in (0.0, _FAR):
        priors = Priors(far=far)
        light, _ = solve_amplitudes(radiance, transfer, (near, Pairs.joined([])), priors, 240)
        albedo = log_ratio(radiance.linear, light.irradiance(transfer))
        spread[far] = float(albedo.std(0).mean())
    without, with_far = spread.values()
    assert with_far < 0.5 * without
    assert with_far < 0.08
