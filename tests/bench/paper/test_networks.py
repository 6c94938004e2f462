# SPDX-License-Identifier: Apache-2.0
"""Networks: encodings, the start as a sphere, and what each output may be."""

from __future__ import annotations

import math

import pytest
import torch

from robir.maths.vectors import fibonacci_sphere
from robir_bench.paper.networks import (
    SdfNetwork,
    encode,
    integrated_encode,
)


def test_encoding_by_hand():
    found = encode(torch.tensor([[0.3, -1.0]]), 2)[0]
    values = [0.3, -1.0]
    angles = [0.3, -1.0, 0.6, -2.0]
    expected = values + [math.sin(a) for a in angles] + [math.cos(a) for a in angles]
    assert torch.allclose(found, torch.tensor(expected), atol=1e-6)


def test_the_integrated_encoding_is_the_mean_over_a_gaussian():
    mean, variance = 0.4, 0.02
    at = torch.linspace(-8.0, 8.0, 4001, dtype=torch.float64)
    weight = torch.exp(-0.5 * at * at)
    values = (mean + math.sqrt(variance) * at)[:, None]
    angles = values * 2.0 ** torch.arange(4)
    waves = torch.cat([angles.sin(), angles.cos()], dim=1)
    expected = (weight[:, None] * waves).sum(0) / weight.sum()
    found = integrated_encode(torch.tensor([[mean]], dtype=torch.float64), 4, variance)[0]
    assert torch.allclose(found, expected, atol=1e-6)


@pytest.mark.parametrize(("depth", "width"), [(8, 256), (4, 96)])
def test_the_distance_starts_as_that_to_a_sphere(depth, width):
    network = SdfNetwork(depth, width, 6)
    radius = torch.tensor([0.25, 0.5, 0.9])
    points = fibonacci_sphere(200)[:, None] * radius[:, None]
    with torch.no_grad():
        found = network(points.reshape(-1, 3))[:, 0].view(-1, 3)
    # Softplus lifts small values, so the slope is a little less than 1.
    assert torch.allclose(found.mean(dim=0), radius - 0.5, atol=0.16)
    assert (found[:, 0] < 0.0).all()
    assert (found[:, 2] > 0.0).float().mean() > 0.95
    _, _, gradient = network.with_gradient(points[:, 2])
    cosine = torch.nn.functional.cosine_similarity(gradient, points[:, 2])
    assert cosine.mean() > 0.93


def test_the_gradient_is_that_of_the_distance():
    network = SdfNetwork(4, 32, 4).double()
    points = torch.rand(10, 3).double()
    value, feature, gradient = network.with_gradient(points)
    step = 1e-6
    for axis in range(3):
        moved = points.clone()
        moved[:, axis] += step
        slope = (network(moved)[:, 0] - value) / step
        assert torch.allclose(slope, gradient[:, axis], atol=1e-4)
    assert feature.shape == (10, 32)
