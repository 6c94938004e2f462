# SPDX-License-Identifier: Apache-2.0
"""What keeps the fit from digging where the photographs do not decide: mirrors above all."""

from __future__ import annotations

import pytest
import torch
from torch.nn.functional import normalize

from robir.geometry.fit import optimise as fit
from robir.geometry.fit.field import ColourNetwork, Field
from robir.geometry.fit.sampling import Occupancy, march
from robir.geometry.lattice import Lattice, smoothed


def test_smoothing_takes_lumps_at_first_and_leaves_a_ball_as_it_is_in_the_end() -> None:
    lattice = Lattice(lower=(-12.0, -12.0, -12.0), cell=1.0, shape=(25, 25, 25))
    nodes = lattice.nodes()
    inner = (nodes.abs() < 6).all(1)
    lumps = torch.sin(nodes[:, 0] * torch.pi / 3.0) * torch.cos(nodes[:, 1] * torch.pi / 3.0)
    field = nodes[:, 2] + lumps
    for step in range(28):
        fit.smooth(field, lattice, step / 72)
    assert (field - nodes[:, 2])[inner].abs().max() < 0.1
    ball = nodes.norm(dim=1) - 5.0
    field = ball.clone()
    for step in range(50, 72):
        fit.smooth(field, lattice, step / 72)
    near = ball.abs() < 0.7
    # a twentieth of the way to the end lifts it by a thirteenth of a cell
    assert (field - ball)[near].mean().abs() < 0.05


def test_the_gradient_is_filtered_by_two_passes_of_1_2_1() -> None:
    lattice = Lattice(lower=(0.0, 0.0, 0.0), cell=1.0, shape=(9, 8, 7))
    values = torch.zeros(lattice.shape)
    values[4, 3, 3] = 1.0
    row = torch.tensor([1.0, 4.0, 6.0, 4.0, 1.0]) / 16.0
    expected = torch.zeros(lattice.shape)
    expected[2:7, 1:6, 1:6] = row[:, None, None] * row[:, None] * row
    found = smoothed(values.view(-1), lattice, 2).view(lattice.shape)
    torch.testing.assert_close(found, expected)


@pytest.mark.parametrize(("inv_std", "steps"), [(5.0, 3), (18.0, 4), (60.0, 5)])
def test_steps_grow_shorter_with_the_surface_and_see_the_same_coverage(
    inv_std: float, steps: int
) -> None:
    """Rays of various slants onto a plane, whose coverage is known in closed form."""
    lattice = Lattice(lower=(-1.0, -1.0, -2.0), cell=0.1, shape=(21, 21, 41))
    height = lattice.nodes()[:, 2]
    occupancy = Occupancy.of(lattice, height, 5.0 / inv_std + lattice.cell)
    slant = torch.linspace(0.0, 0.2, 20)
    directions = normalize(torch.stack([slant, 0 * slant, slant - 1.0], dim=1), dim=1)
    origins = torch.tensor([0.0, 0.0, 3.0]).expand(20, 3).contiguous()
    jitter = torch.linspace(0.0, 0.99, 20)
    intervals = march(occupancy, height, inv_std, origins, directions, jitter)
    between = intervals.distance.diff()[intervals.joined > 0]
    torch.testing.assert_close(between, torch.full_like(between, 0.2 / steps), rtol=1e-3, atol=1e-5)
    field = Field(lattice, height, 8, fit._SOFT_PASSES)
    rays = (origins, directions)
    _, coverage = field.render(
        intervals, field.looked_up(intervals), ColourNetwork(8), rays, inv_std
    )
    # the band ends where the surface still covers a per cent
    assert (coverage > 0.97).all()


def test_nodes_out_of_reach_stay_and_keep_their_moments() -> None:
    """Half the nodes wait for some steps; both halves then end the same."""
    lattice = Lattice(lower=(0.0, 0.0, 0.0), cell=1.0, shape=(24, 12, 12))
    everywhere = torch.ones(lattice.count, dtype=torch.bool)
    low = torch.zeros(lattice.shape, dtype=torch.bool)
    low[:12] = True
    whole, part = (Field(lattice, torch.zeros(lattice.count), 4) for _ in range(2))
    one, two = (fit._Optimiser(field, ColourNetwork(4), 0.1) for field in (whole, part))
    one.follow(whole, everywhere, whole.place_features(everywhere))
    for step in range(6):
        wanted = everywhere if step % 2 == 0 else low.view(-1)
        two.follow(part, wanted, part.place_features(wanted))
        before = part.sdf.detach().clone().view(lattice.shape)
        for leaf, steps in ((whole, one), (part, two)):
            leaf.sdf.grad = torch.full((lattice.count,), -1.0)
            steps._move_distances(0.1)
        if step % 2:
            after = part.sdf.detach().view(lattice.shape)
            torch.testing.assert_close(after[12:], before[12:])
            assert (after[:12] > before[:12]).all()
    ended = (field.sdf.detach().view(lattice.shape)[:12] for field in (part, whole))
    torch.testing.assert_close(*ended)
