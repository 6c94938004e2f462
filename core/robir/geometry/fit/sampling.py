# SPDX-License-Identifier: Apache-2.0
"""Samples on rays near the surface, packed: a march through two levels of occupancy.

Batch letters: R rays, S intervals (packed, in ray order), Q interval end points.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn.functional import max_pool3d, pad

from robir.geometry.lattice import Lattice, taken
from robir.maths.volume import log_survival_between, weights

_BLOCK = 2  # edge of a block of the coarse occupancy (cells)
_LEAST_STEPS = 3  # fewest steps that a ray takes along such an edge
# most of them. In between, no step is longer than the width of the soft surface, 1 / inv_std:
# early on that is soft, and shorter ones find no more.
_MOST_STEPS = 5
_LEAST_WEIGHT = 2e-4  # intervals that contribute less than this to their pixel are dropped


@dataclass(frozen=True, slots=True, kw_only=True)
class Occupancy:
    """Where the surface may be."""

    lattice: Lattice  # lattice of the field
    near: Tensor  # (N,) bool, nodes within the band around the surface
    blocks: Tensor  # blocks of cells that hold such a node or touch one that does, flat bool
    block_shape: tuple[int, int, int]  # number of blocks along x, y and z

    @classmethod
    def of(cls, lattice: Lattice, sdf: Tensor, band: float) -> Occupancy:
        """Occupancy of the band |sdf| < `band` around the surface."""
        near = sdf.abs() < band
        grid = near.view(lattice.shape).float()[None, None]
        fill = [(-n) % _BLOCK for n in lattice.shape]
        blocks = max_pool3d(pad(grid, (0, fill[2], 0, fill[1], 0, fill[0])), _BLOCK)
        blocks = max_pool3d(blocks, 3, stride=1, padding=1)[0, 0] > 0
        shape = (int(blocks.shape[0]), int(blocks.shape[1]), int(blocks.shape[2]))
        return cls(
            lattice=lattice,
            near=near,
            blocks=blocks.reshape(-1),
            block_shape=shape,
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Intervals:
    """Packed end points of intervals of rays; neighbours on a ray share one."""

    ray: Tensor  # (Q,) ray of each end point
    first: Tensor  # (Q,) first end point of the same ray
    # (Q - 1,) 1 where there is an interval from a point to the next, 0 where there is none
    joined: Tensor
    distance: Tensor  # (Q,) distance of the end points from their ray's origin
    index: Tensor  # (Q, 8) lattice nodes around the end points
    weight: Tensor  # (Q, 8) their trilinear weights


def _first_of_runs(ray: Tensor) -> Tensor:
    """Index of the first element of each run of equal values, for every element."""
    begins = torch.ones_like(ray, dtype=torch.bool)
    begins[1:] = ray[1:] != ray[:-1]
    return torch.cummax(torch.where(begins, torch.arange(len(ray), device=ray.device), 0), 0)[0]


def _flat_index(
    begin: Tensor, slope: Tensor, along: Tensor, shape: tuple[int, int, int], shift: float
) -> Tensor:
    """Flat indices (K, B) int32 of the cells that points `along` rays fall into, or nearest."""
    flat: Tensor | None = None
    for axis in range(3):
        cell = torch.addcmul(begin[axis] + shift, along, slope[axis])
        # truncation rounds down once nothing is negative
        cell = cell.clamp_(0.0, shape[axis] - 1.0).int()
        flat = cell if flat is None else flat.mul_(shape[axis]).add_(cell)
    assert flat is not None
    return flat


def _occupied_steps(
    occupancy: Occupancy, inv_std: float, origins: Tensor, directions: Tensor, jitter: Tensor
) -> tuple[Tensor, Tensor, Tensor, float]:
    """Ray (S,) and number (S,) of steps inside the band, distance (R,) at step 0, step length."""
    lattice = occupancy.lattice
    long_step = _BLOCK * lattice.cell
    steps = min(max(math.ceil(long_step * inv_std), _LEAST_STEPS), _MOST_STEPS)
    step = long_step / steps
    lower, upper = origins.new_tensor(lattice.lower), origins.new_tensor(lattice.upper)
    inverse = 1.0 / torch.where(directions.abs() < 1e-9, 1e-9, directions)
    one, two = (lower - origins) * inverse, (upper - origins) * inverse
    enter = torch.minimum(one, two).amax(1).clamp(min=0.0) - jitter * step
    leave = torch.maximum(one, two).amin(1)
    count = int(((leave - enter).clamp(min=0.0) / long_step).max().ceil()) + 1
    middle = (torch.arange(count, device=origins.device) + 0.5) * long_step
    # coordinates in rows, and the few steps of a block in a column: short last axes are slow
    begin = lattice.scaled(origins + enter[:, None] * directions).T.contiguous()
    slope = (directions / lattice.cell).T.contiguous()
    first, along = (rows[..., None] / _BLOCK for rows in (begin, slope))
    blocks = _flat_index(first, along, middle, occupancy.block_shape, 0.0)
    hit = taken(occupancy.blocks, blocks)
    hit &= middle < (leave - enter)[:, None] + long_step
    ray, long_number = hit.nonzero(as_tuple=True)
    within = torch.arange(steps, device=ray.device)[:, None]
    nodes = _flat_index(
        begin.index_select(1, ray),
        slope.index_select(1, ray),
        (long_number * steps + within + 0.5) * step,
        lattice.shape,
        0.5,
    )
    block, late = taken(occupancy.near, nodes).T.nonzero(as_tuple=True)
    number = long_number.index_select(0, block) * steps + late
    return ray.index_select(0, block), number, enter, step


def _chain(ray: Tensor, number: Tensor) -> tuple[Tensor, Tensor]:
    """Each end point's interval (Q,), and whether it is its end; touching ones share a point."""
    closes = torch.ones_like(ray, dtype=torch.bool)
    closes[:-1] = (ray[1:] != ray[:-1]) | (number[1:] != number[:-1] + 1)
    owner = torch.repeat_interleave(torch.arange(len(ray), device=ray.device), 1 + closes.long())
    late = torch.zeros_like(owner, dtype=torch.bool)
    torch.eq(owner[1:], owner[:-1], out=late[1:])
    return owner, late


def march(
    occupancy: Occupancy,
    sdf: Tensor,
    inv_std: float,
    origins: Tensor,
    directions: Tensor,
    jitter: Tensor,
) -> Intervals:
    """Intervals that matter for the pixels of rays, found without gradients; there may be none.

    Of signed distances (N,), NeuS' steepness, 1 / unit frame, and rays: origins (R, 3), unit
    directions (R, 3), and the offset (R,) of their steps as a share of a step, in [0, 1).
    """
    lattice = occupancy.lattice
    ray, number, enter, step = _occupied_steps(occupancy, inv_std, origins, directions, jitter)
    owner, late = _chain(ray, number)
    ray = taken(ray, owner)
    distance = taken(enter, ray) + (taken(number, owner) + late) * step
    # coordinates in rows, as in `_occupied_steps`
    points = origins.T.contiguous().index_select(1, ray)
    points += distance * directions.T.contiguous().index_select(1, ray)
    log_step = log_survival_between(lattice.trilinear(sdf, points.T), inv_std) * ~late[:-1]
    keep = weights(log_step, _first_of_runs(ray)[:-1]) > _LEAST_WEIGHT
    ends = torch.zeros_like(ray, dtype=torch.bool)
    ends[:-1] |= keep
    ends[1:] |= keep
    point = ends.nonzero()[:, 0]
    ray = taken(ray, point)
    index, weight = lattice.corners(points.index_select(1, point).T)
    return Intervals(
        ray=ray,
        first=_first_of_runs(ray),
        joined=taken(keep, point[:-1]).float(),
        distance=taken(distance, point),
        index=index,
        weight=weight,
    )
