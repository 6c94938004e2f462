# SPDX-License-Identifier: Apache-2.0
"""Directions against closed forms: reflection, frames, spreads, the lat-long map."""

import math

import numpy as np
import pytest
import torch

from robir.maths import vectors


def random_directions(count: int, seed: int = 0) -> torch.Tensor:
    generator = torch.Generator().manual_seed(seed)
    return vectors.normalise(torch.randn(count, 3, generator=generator, dtype=torch.float64))


def test_normalise_keeps_zero_finite():
    vector = torch.zeros(2, 3, requires_grad=True)
    unit = vectors.normalise(vector)
    unit.sum().backward()
    assert torch.equal(unit.detach(), torch.zeros(2, 3))
    assert vector.grad.isfinite().all()


def test_reflect_keeps_normal_part_and_turns_the_tangent():
    direction, normal = random_directions(50), random_directions(50, 1)
    mirrored = vectors.reflect(direction, normal)
    assert torch.allclose(vectors.dot(mirrored, normal), vectors.dot(direction, normal))
    tangent = direction - vectors.dot(direction, normal)[:, None] * normal
    turned = mirrored - vectors.dot(mirrored, normal)[:, None] * normal
    assert torch.allclose(turned, -tangent)


def test_frames_are_orthonormal_and_right_handed():
    poles = torch.tensor([[0.0, 0, 1], [0, 0, -1], [0, 1, 0], [1e-9, 0, -1]], dtype=torch.float64)
    normal = torch.cat([random_directions(200), poles])
    tangent, bitangent = vectors.orthonormal_frame(normal)
    frame = torch.stack([tangent, bitangent, normal], dim=-1)
    assert torch.allclose(frame.mT @ frame, torch.eye(3, dtype=torch.float64).expand(204, 3, 3))
    assert torch.allclose(torch.linalg.cross(tangent, bitangent), normal)


def test_tangents_complete_one_direction_to_a_right_handed_frame():
    for axis in [*random_directions(50).numpy(), *np.eye(3), *-np.eye(3)]:
        tangent, bitangent = vectors.tangents(axis)
        frame = np.stack([tangent, bitangent, axis])
        np.testing.assert_allclose(frame @ frame.T, np.eye(3), atol=1e-12)
        np.testing.assert_allclose(np.cross(tangent, bitangent), axis, atol=1e-12)


@pytest.mark.parametrize("count", [1, 2, 64, 512])
def test_fibonacci_sphere_is_balanced(count):
    directions = vectors.fibonacci_sphere(count, dtype=torch.float64)
    assert torch.allclose(directions.norm(dim=-1), torch.ones(count, dtype=torch.float64))
    assert directions[:, 2].mean().abs() < 1e-12
    if count >= 64:
        second = directions.T @ directions / count
        assert (second - torch.eye(3) / 3).abs().max() < 2.0 / count
        nearest = (directions @ directions.T - 2 * torch.eye(count)).max(dim=1).values.acos()
        # A square grid would give sqrt(4 pi / n); the spiral stays near it everywhere.
        assert nearest.min() > 0.75 * math.sqrt(4 * math.pi / count)
        assert nearest.max() < 1.2 * math.sqrt(4 * math.pi / count)


def test_lat_long_landmarks_are_blenders():
    """Centre +X, u = 0.25 is +Y, top +Z."""
    uv = torch.tensor([[0.5, 0.5], [0.25, 0.5], [0.75, 0.5], [0.3, 0.0]], dtype=torch.float64)
    expected = torch.tensor([[1.0, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1]], dtype=torch.float64)
    assert torch.allclose(vectors.direction_from_uv(uv), expected, atol=1e-12)


def test_lat_long_map_integrates_the_sphere():
    directions = vectors.equirect_directions(64, dtype=torch.float64)
    angles = vectors.equirect_solid_angles(64, dtype=torch.float64)
    assert directions.shape == (64, 128, 3)
    assert angles.sum() == pytest.approx(4 * math.pi, rel=1e-12)
    assert directions[0, :, 2].min() > 0.99
    second = torch.einsum("hw,hwi,hwj->ij", angles, directions, directions)
    assert (second - torch.eye(3) * 4 * math.pi / 3).abs().max() < 2e-3


def test_a_ring_lies_at_its_radius_evenly_and_turned():
    axis = np.array([2.0, -1.0, 2.0]) / 3
    found = vectors.ring(axis, 0.3, 5, 0.2)
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), 1.0, atol=1e-12)
    np.testing.assert_allclose(found @ axis, np.cos(0.3), atol=1e-12)
    np.testing.assert_allclose(found.mean(0), np.cos(0.3) * axis, atol=1e-12)
    tangent, bitangent = vectors.tangents(axis)
    first = np.arctan2(found[0] @ bitangent, found[0] @ tangent)
    assert first == pytest.approx(0.2)
