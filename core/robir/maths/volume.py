# SPDX-License-Identifier: Apache-2.0
"""NeuS volume rendering on packed samples: opacity, transmittance and weights.

Batch letters: R rays, S intervals of all rays packed one after the other.

Wang et al. 2021, "NeuS", equations 10 to 13: an interval between two samples of a ray with signed
distances f_i and f_{i+1} has the opacity max(0, (P(f_i) - P(f_{i+1})) / P(f_i)), P the logistic
distribution function with steepness `inv_std`. Everything here works with
log(1 - opacity) = min(0, log P(f_{i+1}) - log P(f_i)), which neither overflows nor cancels.
"""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor
from torch.nn.functional import logsigmoid


def log_survival(sdf_start: Tensor, sdf_end: Tensor, inv_std: float) -> Tensor:
    """Logarithm of the share of light (S,) that passes an interval, log(1 - opacity).

    Of signed distances (S,) where the ray enters and leaves it, negative inside, and the steepness
    of the logistic distribution, 1 / unit of the distance. Zero where the ray moves away from the
    surface.
    """
    step = logsigmoid(inv_std * sdf_end) - logsigmoid(inv_std * sdf_start)
    return step.clamp(max=0.0)


def log_survival_between(sdf: Tensor, inv_std: float) -> Tensor:
    """`log_survival` of the intervals between consecutive points (Q,), shape (Q - 1,)."""
    shone = logsigmoid(inv_std * sdf)
    return (shone[1:] - shone[:-1]).clamp(max=0.0)


def transmittance(log_step: Tensor, first: Tensor) -> Tensor:
    """Share of light (S,) that reaches the start of each interval, 1 at every ray's first one.

    Of log survival (S,) in ray order, and the index (S,) of the first interval of the same ray. In
    the precision of `log_step`.
    """
    total = torch.cumsum(log_step.double(), dim=0)
    before = total - log_step
    return torch.exp(before - before.index_select(0, first)).to(log_step.dtype)


class _Weights(torch.autograd.Function):
    """Transmittance times opacity with the slope in closed form."""

    @staticmethod
    def forward(ctx: Any, log_step: Tensor, first: Tensor) -> Tensor:
        through = transmittance(log_step, first)
        weight = -through * torch.expm1(log_step)
        ctx.save_for_backward(first, through, weight)
        return weight

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor, None]:
        # torch's own goes back through a look-up by `first`, whose scatter costs most; an
        # interval lets less through to itself, by T e^l, and to all behind it, by their weights
        first, through, weight = ctx.saved_tensors
        gradient = gradients[0]
        total = torch.cumsum((gradient * weight).double(), dim=0)
        ends = torch.ones_like(first, dtype=torch.bool)
        torch.ne(first[1:], first[:-1], out=ends[:-1])
        run = torch.cumsum(ends, dim=0) - ends.long()
        behind = total[ends].index_select(0, run) - total
        return behind.to(gradient.dtype) - gradient * (through - weight), None


def weights(log_step: Tensor, first: Tensor) -> Tensor:
    """Share of the pixel (S,) that each interval contributes: transmittance times opacity.

    Of the same as `transmittance`; the sum over a ray is the ray's coverage, at most 1.
    """
    return _Weights.apply(log_step, first)
