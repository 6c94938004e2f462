# SPDX-License-Identifier: Apache-2.0
"""Smoothing of a distance field, taken apart from the optimiser.

Inside Adam the gradients of a regulariser at rarely sampled nodes are blown up to full steps;
as separate explicit steps on the whole lattice they do what their formula says.
"""

from __future__ import annotations

import torch
from torch import Tensor

from robir.geometry.lattice import Lattice


def _padded(grid: Tensor) -> Tensor:
    return torch.nn.functional.pad(grid[None, None], (1, 1, 1, 1, 1, 1), mode="replicate")[0, 0]


def neighbour_mean(grid: Tensor) -> Tensor:
    """Means over the six neighbours of every node (X, Y, Z); beyond the border its nodes go on."""
    wide = _padded(grid)
    total = wide[2:, 1:-1, 1:-1] + wide[:-2, 1:-1, 1:-1]
    total += wide[1:-1, 2:, 1:-1]
    total += wide[1:-1, :-2, 1:-1]
    total += wide[1:-1, 1:-1, 2:]
    total += wide[1:-1, 1:-1, :-2]
    return total.div_(6.0)


def laplacian_step(sdf: Tensor, lattice: Lattice, amount: float) -> None:
    """Move every node towards the mean of its six neighbours, in place.

    Args:
        sdf: (N,).
        lattice: Nodes of the field.
        amount: Share of the way, below 1; less than 0 leads away from it.
    """
    grid = sdf.view(lattice.shape)
    grid.lerp_(neighbour_mean(grid), amount)


def smoothed(values: Tensor, lattice: Lattice, passes: int) -> Tensor:
    """Values filtered by (1, 2, 1) / 4 along each axis, zero beyond the border.

    Args:
        values: (N,).
        lattice: Nodes.
        passes: How often.

    Returns:
        (N,), a new tensor.
    """
    # (1, 2, 1) is (1, 1) twice: sums of two neighbours read and write the least memory
    grid = torch.nn.functional.pad(values.view(lattice.shape), (passes,) * 6)
    for axis in range(3):
        for _ in range(2 * passes):
            size = grid.shape[axis] - 1
            grid = grid.narrow(axis, 0, size) + grid.narrow(axis, 1, size)
    return grid.mul_(0.25 ** (3 * passes)).reshape(-1)
