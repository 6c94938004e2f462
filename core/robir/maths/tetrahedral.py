# SPDX-License-Identifier: Apache-2.0
"""Regular lattices of colours: tetrahedral interpolation and its inverse.

A cell of the lattice is cut into six tetrahedra along its main diagonal. Inside one, the value is
affine: with the fractions of the position sorted, h >= m >= l, and the corners v0 (all low) to v3
(all high) met by raising the axes in that order,

    value = v0 + h (v1 - v0) + m (v2 - v1) + l (v3 - v2).

Colour management systems use the same rule, so a lattice sampled at their nodes repeats them
exactly; grey inputs stay on the diagonal. Positions and values are planar, a tuple of three
tensors of shape (N,), because reductions over a last axis of three are slow on a CPU.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

Planes = tuple[Tensor, ...]


class ColourLattice(NamedTuple):
    """Colours at the nodes of an n x n x n lattice."""

    planes: Planes  # three tensors of shape (n**3,), one per output channel, first axis slowest
    size: int  # nodes per axis, n

    @staticmethod
    def from_nodes(nodes: Tensor) -> ColourLattice:
        """Lattice of an (n, n, n, 3) tensor of node values."""
        red, green, blue = (plane.reshape(-1).contiguous() for plane in nodes.unbind(-1))
        return ColourLattice((red, green, blue), nodes.shape[0])

    def like(self, sample: Tensor) -> ColourLattice:
        """The same lattice in the type and on the device of a tensor."""
        red, green, blue = (plane.to(sample) for plane in self.planes)
        return ColourLattice((red, green, blue), self.size)


class _Cell(NamedTuple):
    """Where positions lie: corner indices, sorted fractions, and first and last axis as masks."""

    corners: tuple[Tensor, Tensor, Tensor, Tensor]
    fractions: Planes
    first: tuple[Tensor, Tensor]
    last: tuple[Tensor, Tensor]


def _locate(position: Planes, size: int) -> _Cell:
    """Tetrahedron of every position; positions outside the lattice are moved to its border."""
    clamped = [axis.clamp(0.0, size - 1.0) for axis in position]
    lows = [axis.detach().floor().clamp(max=size - 2.0) for axis in clamped]
    f0, f1, f2 = (axis - low for axis, low in zip(clamped, lows, strict=True))
    high = torch.maximum(torch.maximum(f0, f1), f2)
    low = torch.minimum(torch.minimum(f0, f1), f2)
    middle = f0 + f1 + f2 - high - low
    # Ties fall to different axes for first and last, so a tied pair still spans a path.
    first = ((f0 >= f1) & (f0 >= f2), f1 >= f2)
    is_last2 = (f2 <= f1) & (f2 <= f0)
    last = (~is_last2 & (f0 < f1), ~is_last2)
    s0, s1 = size * size, size
    base = torch.add(lows[2], lows[1], alpha=s1).add_(lows[0], alpha=s0).int()
    stride0, stride1, stride2 = base.new_tensor([s0, s1, 1]).unbind()
    raised = torch.where(first[0], stride0, torch.where(first[1], stride1, stride2))
    kept = torch.where(last[0], stride0, torch.where(last[1], stride1, stride2))
    top = base + (s0 + s1 + 1)
    return _Cell((base, base + raised, top - kept, top), (high, middle, low), first, last)


def _at_corners(plane: Tensor, cell: _Cell) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Value at the lowest corner, and the rise along each edge of the path to the highest."""
    v0, v1, v2, v3 = (plane.index_select(0, corner) for corner in cell.corners)
    return v0, v1 - v0, v2 - v1, v3 - v2


def interpolate(lattice: ColourLattice, position: Planes) -> Planes:
    """Colours, three tensors (N,), at positions in nodes from 0 to size - 1; clamped to that range.

    Continuous, and differentiable in the position inside a tetrahedron.
    """
    cell = _locate(position, lattice.size)
    high, middle, low = cell.fractions
    values = []
    for plane in lattice.planes:
        value, a, b, c = _at_corners(plane, cell)
        values.append(value + high * a + middle * b + low * c)
    return tuple(values)


def corner_weights(position: Planes, size: int) -> tuple[Tensor, Tensor]:
    """Flat node indices (N, 4) and weights (N, 4) that `interpolate` would use; for fitting."""
    cell = _locate(position, size)
    high, middle, low = cell.fractions
    weights = torch.stack([1.0 - high, high - middle, middle - low, low], dim=-1)
    return torch.stack(cell.corners, dim=-1), weights


def step_towards(
    lattice: ColourLattice, position: Planes, target: Planes, damping: float, reach: float
) -> tuple[Planes, Tensor]:
    """One Levenberg-Marquardt step on position towards interpolate(position) = target.

    The lattice is affine in a tetrahedron, so its Jacobian is exact and costs no extra look-up.
    `damping` is added to the diagonal of the normal equations, squared value per node; it keeps the
    step small where the lattice is flat. `reach` is the largest step along an axis, in nodes. The
    next positions, and the squared residual (N,) at the given ones.
    """
    cell = _locate(position, lattice.size)
    high, middle, low = cell.fractions
    aa = bb = cc = torch.full_like(high, damping)
    ab = ac = bc = ar = br = cr = error = torch.zeros_like(high)
    for plane, wanted in zip(lattice.planes, target, strict=True):
        value, a, b, c = _at_corners(plane, cell)
        rest = wanted - (value + high * a + middle * b + low * c)
        aa, bb, cc = aa + a * a, bb + b * b, cc + c * c
        ab, ac, bc = ab + a * b, ac + a * c, bc + b * c
        ar, br, cr = ar + a * rest, br + b * rest, cr + c * rest
        error = error + rest * rest
    # Symmetric 3 x 3 system by cofactors: batched solvers cost ten times as much here.
    m00, m01, m02 = bb * cc - bc * bc, bc * ac - ab * cc, ab * bc - bb * ac
    m11, m12, m22 = aa * cc - ac * ac, ab * ac - aa * bc, aa * bb - ab * ab
    scale = 1.0 / (aa * m00 + ab * m01 + ac * m02)
    first = ((m00 * ar + m01 * br + m02 * cr) * scale).clamp(-reach, reach)
    second = ((m01 * ar + m11 * br + m12 * cr) * scale).clamp(-reach, reach)
    third = ((m02 * ar + m12 * br + m22 * cr) * scale).clamp(-reach, reach)
    (first0, first1), (last0, last1) = cell.first, cell.last
    moves = (
        torch.where(first0, first, torch.where(last0, third, second)),
        torch.where(~first0 & first1, first, torch.where(last1 & ~last0, third, second)),
        torch.where(first0 | first1, torch.where(last1, second, third), first),
    )
    moved = tuple(axis + move for axis, move in zip(position, moves, strict=True))
    return moved, error


def interpolate_1d(table: Tensor, position: Tensor) -> Tensor:
    """Piecewise linear values of a table (n,) at positions in nodes, clamped to the table."""
    last = table.shape[0] - 1
    position = position.clamp(0.0, float(last))
    index = position.detach().floor().clamp(max=last - 1).long()
    low = table[index]
    return low + (position - index) * (table[index + 1] - low)


def invert_1d(table: Tensor, value: Tensor) -> Tensor:
    """Positions in nodes at which a strictly increasing table (n,) takes the values.

    Values outside the table are moved to its ends.
    """
    value = value.clamp(table[0].item(), table[-1].item())
    index = torch.searchsorted(table, value.detach().contiguous(), right=True)
    index = (index - 1).clamp(0, table.shape[0] - 2)
    low = table[index]
    return index + (value - low) / (table[index + 1] - low)
