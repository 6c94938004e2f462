# SPDX-License-Identifier: Apache-2.0
"""Steps of the distances are as long as gradients agree, and normals shown are free of lumps."""

from __future__ import annotations

import pytest
import torch

from robir.geometry.config import GeometryConfig
from robir.geometry.fit import descent, optimise
from robir.geometry.fit.descent import Descent, agreement
from robir.geometry.fit.field import Field
from robir.geometry.fit.optimise import fit
from robir.geometry.lattice import Lattice
from robir.geometry.rays import RaySampler

LATTICE = Lattice(lower=(0.0, 0.0, 0.0), cell=1.0, shape=(24, 12, 12))
SOFT = optimise._SOFT_PASSES
EVERYWHERE = torch.ones(LATTICE.count, dtype=torch.bool)


@pytest.mark.parametrize("steps", [10, 60, 300])
def test_random_signs_show_the_agreement_that_chance_gives(steps: int) -> None:
    signs = torch.randint(2, (steps, 20000), generator=torch.Generator().manual_seed(0)) * 2.0 - 1.0
    weights = descent._MEMORY ** torch.arange(steps - 1.0, -1.0, -1.0)
    mean = (weights[:, None] * signs).sum(0) / weights.sum()
    typical = mean.square().mean().sqrt()[None]
    share = agreement(typical, torch.ones(1), steps)
    assert share.item() == pytest.approx(1.0 / (1.0 + descent._DOUBT**2), rel=0.1)


def _moved(signs: torch.Tensor) -> torch.Tensor:
    """Where distances end after gradients (T,) that are the same at all nodes of a cross-section,
    steady below the middle of x and of the given signs above it."""
    distances = torch.zeros(LATTICE.count, requires_grad=True)
    steps = Descent(distances, LATTICE)
    steps.follow(EVERYWHERE)
    for sign in signs:
        gradient = torch.full(LATTICE.shape, -1e-3)
        gradient[12:] *= sign
        distances.grad = gradient.view(-1)
        steps.step(0.1)
    return distances.detach().view(LATTICE.shape)


def test_distances_go_where_gradients_agree_and_stay_where_they_do_not() -> None:
    signs = torch.randint(2, (100,), generator=torch.Generator().manual_seed(1)) * 2.0 - 1.0
    moved = _moved(signs)
    # at first there is nothing to agree with
    assert 8.0 < moved[5, 6, 6].item() < 10.0
    alone = torch.zeros(1, requires_grad=True)
    betas = (descent.FIRST_DECAY, descent.SECOND_DECAY)
    adam, farthest = torch.optim.Adam([alone], lr=0.1, betas=betas), 0.0
    for sign in signs:
        alone.grad = -1e-3 * sign[None]
        adam.step()
        farthest = max(farthest, abs(alone.item()))
    assert abs(moved[19, 6, 6].item()) < 0.4 * farthest


def test_nodes_out_of_reach_stay_and_keep_their_moments() -> None:
    """Half the nodes wait for some steps; both halves then end the same."""
    low = torch.zeros(LATTICE.shape, dtype=torch.bool)
    low[:12] = True
    whole, part = (torch.zeros(LATTICE.count, requires_grad=True) for _ in range(2))
    one, two = Descent(whole, LATTICE), Descent(part, LATTICE)
    one.follow(EVERYWHERE)
    for step in range(6):
        two.follow(EVERYWHERE if step % 2 == 0 else low.view(-1))
        before = part.detach().clone().view(LATTICE.shape)
        for leaf, steps in ((whole, one), (part, two)):
            leaf.grad = torch.full((LATTICE.count,), -1.0)
            steps.step(0.1)
        if step % 2:
            after = part.detach().view(LATTICE.shape)
            torch.testing.assert_close(after[12:], before[12:])
            assert (after[:12] > before[:12]).all()
    torch.testing.assert_close(part.view(LATTICE.shape)[:12], whole.view(LATTICE.shape)[:12])
    assert (two._moments[2].view(LATTICE.shape)[18] < 0).all()  # pyright: ignore[reportPrivateUsage]


def test_the_network_is_shown_the_surface_without_its_lumps() -> None:
    lattice = Lattice(lower=(-12.0, -12.0, -6.0), cell=1.0, shape=(25, 25, 13))
    nodes = lattice.nodes()
    lumps = 0.3 * torch.sin(nodes[:, 0] * torch.pi / 2.0 + 0.4)
    points = torch.zeros(200, 3)
    points[:, 0] = torch.linspace(-4.0, 4.0, 200)
    field = Field(lattice, nodes[:, 2] + 0.2 * nodes[:, 0], 4, SOFT)
    clean = field.gradient(points)
    with torch.no_grad():
        field.sdf += lumps
    field.soften()
    shown = field.gradient(points)
    expected = torch.tensor([0.2, 0.0, 1.0]).expand(200, 3)
    torch.testing.assert_close(clean, expected, atol=5e-3, rtol=0.0)
    torch.testing.assert_close(shown, expected, atol=0.03, rtol=0.0)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_the_border_does_not_turn_what_the_network_is_shown(axis: int) -> None:
    """A slope three cells from the border, the margin around a hull, seen across and along it."""
    lattice = Lattice(lower=(-15.0, -15.0, -15.0), cell=1.0, shape=(31, 31, 31))
    normal = torch.nn.functional.normalize(torch.tensor([[0.0, 0.5, 1.0]]), dim=1).roll(axis, 1)
    points = torch.tensor([[12.0, 0.0, 3.0], [0.0, 12.0, 3.0], [3.0, 0.0, 12.0]])
    for point in points:
        field = Field(lattice, ((lattice.nodes() - point) * normal).sum(1), 4, SOFT)
        shown = torch.nn.functional.normalize(field.gradient(point[None]), dim=1)
        assert (shown * normal).sum().item() > 0.998


class _Empty(RaySampler):
    """Rays through the unit ball that all meet nothing."""

    def __init__(self) -> None:
        self._source = torch.Generator().manual_seed(2)

    def draw(self, count: int) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        aims = torch.randn(count, 3, generator=self._source) * 0.3
        origins = torch.tensor([0.0, 0.0, 3.0]).expand(count, 3).contiguous()
        directions = torch.nn.functional.normalize(aims - origins, dim=1)
        return origins, directions, torch.zeros(count, 4)


def test_the_fit_shows_the_network_the_surface_as_it_is_by_then() -> None:
    lattice = Lattice.around(-torch.ones(3).numpy(), torch.ones(3).numpy(), 16)
    ball = lattice.nodes().norm(dim=1) - 0.8
    config = GeometryConfig(level_cells=(16,), level_steps=(20,), rays=256)
    generator = torch.Generator().manual_seed(0)
    field = fit(_Empty(), (lattice, ball), config, generator, lambda *_: None, lambda *_: None)
    points = torch.randn(50, 3, generator=generator) * 0.4
    shown, start = field.gradient(points), Field(lattice, ball, 4, SOFT).gradient(points)
    field.soften()
    torch.testing.assert_close(shown, field.gradient(points))
    assert (shown - start).abs().max() > 0.05
