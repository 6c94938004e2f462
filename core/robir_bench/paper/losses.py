# SPDX-License-Identifier: Apache-2.0
"""RobIR's regularisers. Batch letters: P points, L entries of a code, K lobes."""

from __future__ import annotations

import torch
from torch import Tensor

from robir_bench.paper.networks import MaterialNetwork

SPARSITY = 0.05  # wanted mean of every entry of a code

RESIDUAL = 0.01  # wanted mean residual of every lobe's visibility ratio

_CODE_NOISE = 0.01
_ROUGHNESS_SHARE = 0.2
_SMALL = 1e-4


def bernoulli_divergence(wanted: float, found: Tensor) -> Tensor:
    """KL(wanted || found) of coins: p log(p / q) + (1 - p) log((1 - p) / (1 - q))."""
    rest = 1.0 - wanted
    one = wanted * torch.log((wanted + _SMALL) / (found + _SMALL))
    return one + rest * torch.log((rest + _SMALL) / (1.0 - found + _SMALL))


def sparsity_loss(code: Tensor) -> Tensor:
    """Divergence of the batch's mean code (P, L) from mostly zero; RobIR Eq. 10."""
    return bernoulli_divergence(SPARSITY, code.mean(dim=0)).mean()


def smoothness_loss(network: MaterialNetwork, code: Tensor, noise: Tensor) -> Tensor:
    """Mean change of the material when its code (P, L) is disturbed; RobIR Eq. 10, as L1.

    Args:
        network: Decodes.
        code: Of a batch.
        noise: Standard normal, of the code's shape.
    """
    albedo, roughness = network.decode(code)
    moved_albedo, moved_roughness = network.decode(code + _CODE_NOISE * noise)
    change = (albedo - moved_albedo).abs().mean()
    return change + _ROUGHNESS_SHARE * (roughness - moved_roughness).abs().mean()


def edge_loss(learnt: Tensor, given: Tensor) -> Tensor:
    """Divergence of the mean residual of the ratios (P, K) from a small one; RobIR Eq. 12.

    Few large deviations at the edges of shadows cost as little as the programs let them.
    """
    return bernoulli_divergence(RESIDUAL, (learnt - given).abs().mean(dim=0)).mean()


def whiteness_loss(amplitude: Tensor) -> Tensor:
    """Variance over the channels of the lobes' hues (K, 3)."""
    hue = torch.nn.functional.normalize(amplitude, dim=-1)
    return hue.var(dim=-1, unbiased=False).mean()
