# SPDX-License-Identifier: Apache-2.0
"""Steps that keep a distance field smooth and a distance, taken apart from the optimiser.

Inside Adam the gradients of a regulariser at rarely sampled nodes are blown up to full steps;
as separate explicit steps on the whole lattice they do what their formula says.
"""

from __future__ import annotations

import torch
from torch import Tensor

from robir.geometry.lattice import Lattice


def _padded(grid: Tensor) -> Tensor:
    return torch.nn.functional.pad(grid[None, None], (1, 1, 1, 1, 1, 1), mode="replicate")[0, 0]


def laplacian_step(sdf: Tensor, lattice: Lattice, amount: float) -> None:
    """Move every node towards the mean of its six neighbours, in place.

    Args:
        sdf: (N,).
        lattice: Nodes of the field.
        amount: Share of the way, in [0, 1).
    """
    grid = sdf.view(lattice.shape)
    wide = _padded(grid)
    total = wide[2:, 1:-1, 1:-1] + wide[:-2, 1:-1, 1:-1]
    total += wide[1:-1, 2:, 1:-1]
    total += wide[1:-1, :-2, 1:-1]
    total += wide[1:-1, 1:-1, 2:]
    total += wide[1:-1, 1:-1, :-2]
    grid.lerp_(total.div_(6.0), amount)


def eikonal_step(sdf: Tensor, lattice: Lattice, amount: float) -> None:
    """One explicit descent step of the eikonal energy sum (|gradient| - 1)^2, in place.

    The descent direction is the divergence of (1 - 1 / |g|) g: diffusion where the gradient is
    too long, its reverse, held to a third of that, where it is too short.

    Args:
        sdf: (N,).
        lattice: Nodes of the field.
        amount: Step in units of the explicit scheme, stable below about 1/6.
    """
    grid = sdf.view(lattice.shape)
    cell = lattice.cell
    wide = _padded(grid)
    centre = [
        (wide[2:, 1:-1, 1:-1] - wide[:-2, 1:-1, 1:-1]) / (2.0 * cell),
        (wide[1:-1, 2:, 1:-1] - wide[1:-1, :-2, 1:-1]) / (2.0 * cell),
        (wide[1:-1, 1:-1, 2:] - wide[1:-1, 1:-1, :-2]) / (2.0 * cell),
    ]
    length = (centre[0] ** 2 + centre[1] ** 2 + centre[2] ** 2).sqrt_().clamp_(min=1e-3)
    conductance = (1.0 - 1.0 / length).clamp_(-1.0 / 3.0, 1.0)
    change = torch.zeros_like(grid)
    for axis in range(3):
        size = grid.shape[axis]
        low, high = conductance.narrow(axis, 0, size - 1), conductance.narrow(axis, 1, size - 1)
        flux = torch.diff(grid, dim=axis) * (0.5 * (low + high))
        change.narrow(axis, 0, size - 1).add_(flux)
        change.narrow(axis, 1, size - 1).sub_(flux)
    grid.add_(change, alpha=amount)
