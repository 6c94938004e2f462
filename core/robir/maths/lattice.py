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

Planes = tuple[Tensor, Tensor, Tensor]


class Lattice(NamedTuple):
    """Colours at the nodes of an n x n x n lattice.

    Attributes:
        planes: Three tensors of shape (n**3,), one per output channel, first axis slowest.
        size: Nodes per axis, n.
    """

    planes: Planes
    size: int

    @staticmethod
    def from_nodes(nodes: Tensor) -> Lattice:
        """Lattice of an (n, n, n, 3) tensor of node values."""
        red, green, blue = (plane.reshape(-1).contiguous() for plane in nodes.unbind(-1))
        return Lattice((red, green, blue), nodes.shape[0])

    def like(self, sample: Tensor) -> Lattice:
        """The same lattice in the type and on the device of a tensor."""
        red, green, blue = (plane.to(sample) for plane in self.planes)
        return Lattice((red, green, blue), self.size)


class _Cell(NamedTuple):
    """Where positions lie: corner indices, sorted fractions, and which axis each belongs to."""

    corners: tuple[Tensor, Tensor, Tensor, Tensor]
    fractions: Planes
    first_axis: Tensor
    last_axis: Tensor


def _locate(position: Planes, size: int) -> _Cell:
    """Tetrahedron of every position; positions outside the lattice are moved to its border."""
    clamped = [axis.clamp(0.0, size - 1.0) for axis in position]
    lows = [axis.detach().floor().clamp(max=size - 2.0) for axis in clamped]
    f0, f1, f2 = (axis - low for axis, low in zip(clamped, lows, strict=True))
    high = torch.maximum(torch.maximum(f0, f1), f2)
    low = torch.minimum(torch.minimum(f0, f1), f2)
    middle = f0 + f1 + f2 - high - low
    # Ties fall to different axes for first and last, so a tied pair still spans a path.
    first = torch.where((f0 >= f1) & (f0 >= f2), 0, torch.where(f1 >= f2, 1, 2))
    last = torch.where((f2 <= f1) & (f2 <= f0), 2, torch.where(f1 <= f0, 1, 0))
    stride0, stride1 = size * size, size
    base = (lows[0] * stride0 + lows[1] * stride1 + lows[2]).long()
    strides = torch.tensor([stride0, stride1, 1], device=base.device)
    top = base + (stride0 + stride1 + 1)
    corners = (base, base + strides[first], top - strides[last], top)
    return _Cell(corners, (high, middle, low), first, last)


def interpolate(lattice: Lattice, position: Planes) -> Planes:
    """Colours at positions between the nodes.

    Args:
        lattice: Node values.
        position: Three tensors (N,), in nodes from 0 to size - 1; clamped to that range.

    Returns:
        Three tensors (N,); continuous, and differentiable in the position inside a tetrahedron.
    """
    cell = _locate(position, lattice.size)
    high, middle, low = cell.fractions
    c0, c1, c2, c3 = cell.corners
    values = []
    for plane in lattice.planes:
        v0, v1, v2, v3 = plane[c0], plane[c1], plane[c2], plane[c3]
        values.append(v0 + high * (v1 - v0) + middle * (v2 - v1) + low * (v3 - v2))
    return values[0], values[1], values[2]


def corner_weights(position: Planes, size: int) -> tuple[Tensor, Tensor]:
    """Flat node indices (N, 4) and weights (N, 4) that `interpolate` would use; for fitting."""
    cell = _locate(position, size)
    high, middle, low = cell.fractions
    weights = torch.stack([1.0 - high, high - middle, middle - low, low], dim=-1)
    return torch.stack(cell.corners, dim=-1), weights


def step_towards(
    lattice: Lattice, position: Planes, target: Planes, damping: float, reach: float
) -> tuple[Planes, Tensor]:
    """One Levenberg-Marquardt step on position towards interpolate(position) = target.

    The lattice is affine in a tetrahedron, so its Jacobian is exact and costs no extra look-up.

    Args:
        lattice: Node values.
        position: Three tensors (N,), in nodes.
        target: Three tensors (N,), wanted values.
        damping: Added to the diagonal of the normal equations, squared value per node; keeps the
            step small where the lattice is flat.
        reach: Largest step along an axis, in nodes.

    Returns:
        The next positions, and the squared residual (N,) at the given ones.
    """
    cell = _locate(position, lattice.size)
    high, middle, low = cell.fractions
    c0, c1, c2, c3 = cell.corners
    aa = bb = cc = torch.full_like(high, damping)
    ab = ac = bc = ar = br = cr = error = torch.zeros_like(high)
    for plane, wanted in zip(lattice.planes, target, strict=True):
        v0, v1, v2, v3 = plane[c0], plane[c1], plane[c2], plane[c3]
        a, b, c = v1 - v0, v2 - v1, v3 - v2
        rest = wanted - (v0 + high * a + middle * b + low * c)
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
    moved = [
        axis
        + torch.where(
            cell.first_axis == index, first, torch.where(cell.last_axis == index, third, second)
        )
        for index, axis in enumerate(position)
    ]
    return (moved[0], moved[1], moved[2]), error


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
