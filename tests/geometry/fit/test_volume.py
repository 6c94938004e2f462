# SPDX-License-Identifier: Apache-2.0
"""NeuS weights against their closed form."""

from __future__ import annotations

import torch

from robir.maths.volume import (
    log_survival,
    log_survival_between,
    transmittance,
    weights,
)


def test_coverage_of_a_plane_is_the_closed_form() -> None:
    """A ray that only approaches the surface lets P(f_end) / P(f_start) of the light through."""
    for inv_std in (5.0, 40.0, 300.0):
        sdf = torch.linspace(0.3, -0.2, 65, dtype=torch.float64)
        step = log_survival(sdf[:-1], sdf[1:], inv_std)
        weight = weights(step, torch.zeros(64, dtype=torch.long))
        through = torch.sigmoid(inv_std * sdf[-1]) / torch.sigmoid(inv_std * sdf[0])
        torch.testing.assert_close(weight.sum(), 1.0 - through, rtol=1e-9, atol=1e-12)
        # every weight is the difference of the survival at its ends
        survival = torch.sigmoid(inv_std * sdf) / torch.sigmoid(inv_std * sdf[0])
        torch.testing.assert_close(weight, survival[:-1] - survival[1:], rtol=1e-7, atol=1e-12)


def test_opacity_is_equation_13_and_zero_when_leaving() -> None:
    one, two = torch.rand(100, dtype=torch.float64) - 0.5, torch.rand(100).double() - 0.5
    before, after = torch.sigmoid(20.0 * one), torch.sigmoid(20.0 * two)
    expected = ((before - after) / before).clamp(min=0.0)
    opacity = 1.0 - log_survival(one, two, 20.0).exp()
    torch.testing.assert_close(opacity, expected)
    assert log_survival(torch.tensor([-0.1]), torch.tensor([0.1]), 50.0).item() == 0.0


def test_rays_packed_together_do_not_touch_each_other() -> None:
    generator = torch.Generator().manual_seed(1)
    step = -torch.rand(12, generator=generator)
    first = torch.tensor([0] * 5 + [5] * 7)
    both = transmittance(step, first)
    apart = torch.cat(
        [
            transmittance(step[:5], torch.zeros(5, dtype=torch.long)),
            transmittance(step[5:], torch.zeros(7, dtype=torch.long)),
        ]
    )
    torch.testing.assert_close(both, apart)
    product = torch.cumprod(torch.exp(step[:5]), 0)
    torch.testing.assert_close(both[1:5], product[:4])


def test_far_inside_nothing_overflows() -> None:
    value = log_survival(torch.tensor([-1.0, 1.0]), torch.tensor([-1.1, -1.0]), 1e4)
    assert torch.isfinite(value).all()
    torch.testing.assert_close(value[0], torch.tensor(-1e3), rtol=1e-3, atol=0.0)


def test_the_slope_of_the_weights_is_that_of_transmittance_times_opacity() -> None:
    generator = torch.Generator().manual_seed(2)
    first = torch.tensor([0] * 5 + [5] + [6] * 6)
    step = -torch.rand(12, generator=generator, dtype=torch.float64)
    step[3] = 0.0
    step.requires_grad_()
    wanted = torch.rand(12, generator=generator, dtype=torch.float64)
    plain = -transmittance(step, first) * torch.expm1(step)
    (expected,) = torch.autograd.grad((wanted * plain).sum(), step)
    (found,) = torch.autograd.grad((wanted * weights(step, first)).sum(), step)
    torch.testing.assert_close(found, expected)


def test_intervals_between_points_are_those_of_their_ends() -> None:
    sdf = torch.linspace(0.3, -0.2, 30).sin()
    expected = log_survival(sdf[:-1], sdf[1:], 40.0)
    torch.testing.assert_close(log_survival_between(sdf, 40.0), expected)
