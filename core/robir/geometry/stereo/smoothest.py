# SPDX-License-Identifier: Apache-2.0
"""The smoothest distances that agree with what was measured: sharp where it was, smooth elsewhere.

They have the least sum of squared Laplacians and weighted squared deviations, the smoothing spline
of Duchon 1977, "Splines minimizing rotation-invariant semi-norms in Sobolev spaces", on a grid.
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn.functional import avg_pool3d, interpolate, pad

_COARSEST = 12  # nodes along a side below which a grid is not halved any more
# of conjugate gradients on each grid; each begins with the solution on half of its nodes
_ITERATIONS = 60


def laplacian(grid: Tensor) -> Tensor:
    """Second differences of (X, Y, Z), in units of cells; nothing leaves through the border."""
    total = torch.zeros_like(grid)
    for axis in range(3):
        step = grid.diff(dim=axis)
        total.narrow(axis, 0, step.shape[axis]).add_(step)
        total.narrow(axis, 1, step.shape[axis]).sub_(step)
    return total


def smoothest(measured: Tensor, weight: Tensor, smoothness: float) -> Tensor:
    """Grid with the least sum of weight (f - measured)^2 + smoothness (laplacian f)^2."""
    if min(measured.shape) <= _COARSEST:
        return _solved((measured, weight), measured, smoothness, _ITERATIONS)
    # a cell of half the grid holds eight nodes, and twice the step is a sixteenth of the bending
    total = _halved(weight)
    mean = _halved(weight * measured) / total
    coarse = smoothest(mean, 8 * total, 8 / 16 * smoothness)
    finer = interpolate(coarse[None, None], scale_factor=2, mode="trilinear", align_corners=False)[
        0, 0
    ]
    width, height, depth = measured.shape
    start = finer[:width, :height, :depth]
    return _solved((measured, weight), start, smoothness, _ITERATIONS)


def _halved(grid: Tensor) -> Tensor:
    """Means of eight nodes each; an odd last one counts twice."""
    odd = [part for side in reversed(grid.shape) for part in (0, side % 2)]
    return avg_pool3d(pad(grid[None, None], odd, mode="replicate"), 2)[0, 0]


def _solved(
    known: tuple[Tensor, Tensor], start: Tensor, smoothness: float, iterations: int
) -> Tensor:
    """The minimum by conjugate gradients, of what was measured and its weight."""
    measured, weight = known

    def apply(grid: Tensor) -> Tensor:
        return weight * grid + smoothness * laplacian(laplacian(grid))

    inverse = 1 / (weight + 42 * smoothness)  # the diagonal away from the border
    found = start.clone()
    rest = weight * measured - apply(found)
    step = inverse * rest
    direction, before = step.clone(), (rest * step).sum()
    for _ in range(iterations):
        applied = apply(direction)
        share = before / (direction * applied).sum().clamp(min=1e-20)
        found += share * direction
        rest -= share * applied
        step = inverse * rest
        now = (rest * step).sum()
        direction = step + now / before.clamp(min=1e-20) * direction
        before = now
    return found
