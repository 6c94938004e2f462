# SPDX-License-Identifier: Apache-2.0
"""One radiance per sample, and which samples are compared."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from robir.appearance.photometry.statistics import (
    Pairs,
    diffuse_radiance,
    neighbour_pairs,
    shadow_pairs,
)
from robir.transport.observe import Observations
from robir.transport.surfels import Surfels


def observations(weight: np.ndarray, clipped: np.ndarray | None = None) -> Observations:
    shape = (*weight.shape, 3)
    return Observations(
        display=np.zeros(shape, np.uint8),
        weight=weight.astype(np.float32),
        clipped=np.zeros(shape, bool) if clipped is None else clipped,
        off_axis=np.zeros(weight.shape, np.uint8),
        positions=np.zeros((weight.shape[1], 3), np.float32),
        views=tuple(map(str, range(weight.shape[1]))),
    )


def test_highlights_and_the_darkest_views_are_left_out():
    values = torch.tensor([5.0, 0.3, 0.01, 0.32, 0.31, 2.0, 1.0, 0.9, 0.8, 0.7])
    linear = values[None, :, None].expand(1, 10, 3)
    radiance = diffuse_radiance(observations(np.ones((1, 10))), linear)
    # Ranks 1 to 4 of 10.
    torch.testing.assert_close(radiance.linear[0], torch.full((3,), (0.3 + 0.31 + 0.32 + 0.7) / 4))


def test_clipped_is_judged_by_the_views_that_are_used():
    linear = torch.tensor([[0.2, 0.3, 0.4, 9.0], [1.0, 1.0, 1.0, 1.0]])[..., None].expand(2, 4, 3)
    clipped = np.zeros((2, 4, 3), bool)
    clipped[0, 3] = True
    clipped[1, :, 0] = True
    radiance = diffuse_radiance(observations(np.ones((2, 4)), clipped), linear)
    assert radiance.clipped.tolist() == [[False] * 3, [True, False, False]]


@pytest.fixture
def floor() -> Surfels:
    rng = np.random.default_rng(0)
    position = np.concatenate([rng.uniform(-1, 1, (2000, 2)), np.zeros((2000, 1))], axis=1)
    normal = np.broadcast_to([0.0, 0.0, 1.0], position.shape)
    return Surfels(position=np.float32(position), normal=np.float32(normal), spacing=0.045)


def test_neighbours_lie_as_far_apart_as_asked(floor):
    usable = np.arange(0, 2000, 2)
    reaches = (0.1, 0.4)
    pairs = neighbour_pairs(floor, usable, reaches, 2, np.random.default_rng(1))
    assert float(pairs.weight.sum()) == pytest.approx(1, rel=1e-4)
    assert int(pairs.first.max()) < 1000 and int(pairs.second.max()) < 1000
    assert not (pairs.first == pairs.second).any()
    position = floor.position[usable]
    distance = np.linalg.norm(position[pairs.first] - position[pairs.second], axis=1)
    assert distance.max() < 1.5 * max(reaches) + floor.spacing
    # Pairs of either length.
    assert (distance < 0.15).mean() > 0.3 and (distance > 0.2).mean() > 0.2


def test_a_shadow_is_compared_with_the_lit_ground_beside_it(floor):
    position, normal = floor.position, floor.normal.copy()
    lit, dark = position[:, 0] > 0.05, position[:, 0] < -0.05
    # Every other sample is of a wall: the nearest in place alone may face another way.
    normal[::2] = [1, 0, 0]
    pairs = shadow_pairs(position, normal, lit, dark)
    first, second = pairs.first.numpy(), pairs.second.numpy()
    assert len(first) > 100 and dark[first].all() and lit[second].all()
    assert np.linalg.norm(position[first] - position[second], axis=1).max() < 0.8
    # A low sun's shadow is long: its inner part has partners, too.
    assert position[first, 0].min() < -0.6
    np.testing.assert_array_equal(normal[first], normal[second])
    assert float(pairs.weight.sum()) == pytest.approx(1, rel=1e-4)


def test_pairs_are_alike_by_hue_and_brightness_but_for_a_step():
    step = torch.tensor([-0.6, -0.4, -0.3])
    red = torch.tensor([0.2, -0.1, -0.1])
    log_albedo = torch.stack([step, torch.zeros(3), red, torch.full((3,), 0.35)])
    pairs = Pairs(
        first=torch.tensor([0, 0, 0]),
        second=torch.tensor([1, 2, 3]),
        weight=torch.tensor([0.5, 0.3, 0.2]),
    )
    alike = pairs.likeness(log_albedo, 0.1, 0.35, step)
    expected = np.exp(-0.5 * np.array([0.0, 0.06 / 0.01, 1.0]))
    np.testing.assert_allclose(alike.numpy(), expected, rtol=1e-5)
    without = np.exp(-0.5 * (step.numpy().var() * 3 / 0.1**2 + (step.mean().item() / 0.35) ** 2))
    assert float(pairs.likeness(log_albedo, 0.1, 0.35)[0]) == pytest.approx(without, rel=1e-4)


def test_the_commonest_step_is_that_of_a_wrong_light_whatever_the_materials():
    rng = np.random.default_rng(0)
    dielectrics = np.log([[0.16, 0.22, 0.21], [0.4, 0.41, 0.41], [0.6, 0.1, 0.1]])
    # more of the bright in the shade, more of the dark in the sun: a median would be led astray
    shaded = dielectrics[rng.choice(3, 600, p=[0.3, 0.5, 0.2])] + [-0.6, -0.45, -0.3]
    lit = dielectrics[rng.choice(3, 600, p=[0.5, 0.3, 0.2])]
    log_albedo = torch.from_numpy(np.concatenate([shaded, lit]) + rng.normal(0, 0.05, (1200, 3)))
    pairs = Pairs(
        first=torch.arange(600).repeat(4),
        second=torch.from_numpy(rng.integers(600, 1200, 2400)),
        weight=torch.full((2400,), 1 / 2400),
    )
    step = pairs.common_step(log_albedo.float())
    np.testing.assert_allclose(step.numpy(), [-0.6, -0.45, -0.3], atol=0.03)
    none = pairs.of(torch.zeros(2400, dtype=torch.bool))
    assert none.common_step(log_albedo).tolist() == [0] * 3
