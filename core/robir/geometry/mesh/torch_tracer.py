# SPDX-License-Identifier: Apache-2.0
"""Rays against a triangle mesh in torch, for CUDA devices; runs on the CPU too.

The triangles are halved again and again across the widest axis of their centres, so that the tree
is complete: node i has the children 2 i and 2 i + 1, the root is 1, and the leaves hold at most
LEAF_SIZE triangles each. All rays walk it at once, one node a step, the nearer child first.

No ray keeps a stack. Of the nodes on its way down it only remembers, bit by bit, whose sibling is
still to be visited: bit j of `pending` stands for the sibling of `node >> j`. The next node after a
miss or a leaf is then the sibling of the deepest of them (Laine, Restart Trail for Stackless BVH
Traversal, HPG 2010, whose restart the complete tree makes unnecessary).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from robir.geometry.mesh.tracing import AbstractTracer, Floats, Hits

LEAF_SIZE = 4

CHUNK_CPU, CHUNK_CUDA = 1 << 16, 1 << 21
"""Rays walked at once: small enough for the processor's cache, large enough to fill a GPU."""

STEPS_BETWEEN_SWEEPS = 8
"""Steps after which rays that are done are put aside."""

SLACK = 2e-6
"""Relative widening of boxes, and of triangles in barycentric coordinates, against rounding: no ray
slips through between two triangles."""


@dataclass(slots=True)
class _Walk:
    """Rays on their way through the tree, all arrays of one length.

    Attributes:
        ray: (A,) int64, index into the chunk.
        origin: (A, 3).
        direction: (A, 3) unit.
        inverse: (A, 3) one over the direction, finite.
        node: (A,) int64, current node; 0 when done.
        pending: (A,) int64, siblings still to visit.
        distance: (A,) nearest hit so far, at first the reach.
        face: (A,) int64, its position in the tree's order of triangles, -1 without a hit.
        u: (A,) its weight of the second corner.
        v: (A,) its weight of the third corner.
    """

    ray: Tensor
    origin: Tensor
    direction: Tensor
    inverse: Tensor
    node: Tensor
    pending: Tensor
    distance: Tensor
    face: Tensor
    u: Tensor
    v: Tensor

    def subset(self, rows: Tensor) -> _Walk:
        """Some of the rays."""
        return _Walk(*(getattr(self, name)[rows] for name in self.__dataclass_fields__))


class TorchTracer(AbstractTracer):
    """A complete binary tree of boxes, walked by all rays at once."""

    def __init__(self, vertices: Floats, faces: NDArray[np.int32], device: str) -> None:
        """Build the tree.

        Args:
            vertices: (Nv, 3), any frame; rays are in the same frame.
            faces: (Nf, 3), at least one.
            device: Where rays are walked, as torch names it.
        """
        self._device = torch.device(device)
        corners = vertices.astype(np.float32)[faces]
        order, depth, axes = _halved(corners.mean(1))
        count = 1 << depth
        starts = np.arange(count + 1) * len(order) // count
        # Leaves differ by one triangle at most; the short ones repeat their last.
        slots = np.minimum(
            starts[:-1, None] + np.arange(np.diff(starts).max()), starts[1:, None] - 1
        )
        leaves = corners[order][slots]
        self._first_leaf = count
        self._bounds = torch.from_numpy(_boxes(leaves)).to(self._device)
        self._axes = torch.from_numpy(axes).to(self._device)
        self._leaves = torch.from_numpy(leaves).to(self._device)
        self._faces = order[slots].astype(np.int32)

    def first_hits(self, origins: Floats, directions: Floats) -> Hits:
        """Nearest surface along every ray; see AbstractTracer."""
        face = np.full(len(origins), -1, np.int32)
        distance = np.full(len(origins), np.inf, np.float32)
        barycentric = np.zeros((len(origins), 3), np.float32)
        for chunk, walk in self._walks(origins, directions, None, any_hit=False):
            u, v = walk.u.cpu().numpy(), walk.v.cpu().numpy()
            place = walk.face.cpu().numpy()
            hit = place >= 0
            face[chunk] = np.where(hit, self._faces.reshape(-1)[place], -1)
            distance[chunk] = walk.distance.cpu().numpy()
            barycentric[chunk] = np.stack([1 - u - v, u, v], axis=1) * hit[:, None]
        return Hits(face, distance, barycentric)

    def is_blocked(
        self, origins: Floats, directions: Floats, reach: Floats | None = None
    ) -> NDArray[np.bool_]:
        """Whether anything lies on each ray; see AbstractTracer."""
        blocked = np.zeros(len(origins), bool)
        for chunk, walk in self._walks(origins, directions, reach, any_hit=True):
            blocked[chunk] = (walk.face >= 0).cpu().numpy()
        return blocked

    def _walks(
        self, origins: Floats, directions: Floats, reach: Floats | None, *, any_hit: bool
    ) -> Iterator[tuple[slice, _Walk]]:
        """Chunks of the rays as slices, with all their rays walked to the end, in order."""
        size = CHUNK_CUDA if self._device.type == "cuda" else CHUNK_CPU
        for start in range(0, len(origins), size):
            chunk = slice(start, min(start + size, len(origins)))
            walk = self._start(
                origins[chunk], directions[chunk], None if reach is None else reach[chunk]
            )
            yield chunk, self._finish(walk, any_hit)

    def _start(self, origins: Floats, directions: Floats, reach: Floats | None) -> _Walk:
        """All rays of a chunk at the root."""
        origin, direction = (
            torch.from_numpy(np.array(values, np.float32)).to(self._device)
            for values in (origins, directions)
        )
        count = len(origin)
        tiny = torch.copysign(torch.full_like(direction, 1e-20), direction)
        integers = torch.zeros(count, dtype=torch.int64, device=self._device)
        unlimited = torch.full((count,), torch.inf, device=self._device)
        return _Walk(
            ray=torch.arange(count, device=self._device),
            origin=origin,
            direction=direction,
            inverse=1 / torch.where(direction.abs() < 1e-20, tiny, direction),
            node=integers + 1,
            pending=integers,
            distance=unlimited
            if reach is None
            else torch.from_numpy(np.array(reach, np.float32)).to(self._device),
            face=integers - 1,
            u=torch.zeros_like(unlimited),
            v=torch.zeros_like(unlimited),
        )

    def _finish(self, walk: _Walk, any_hit: bool) -> _Walk:
        """Walk until every ray is done; the rays in their first order."""
        done: list[_Walk] = []
        while len(walk.ray):
            for _ in range(STEPS_BETWEEN_SWEEPS):
                self._step(walk, any_hit)
            over = walk.node == 0
            done.append(walk.subset(over))
            walk = walk.subset(~over)
        ended = _Walk(
            *(
                torch.cat([getattr(part, name) for part in done])
                for name in _Walk.__dataclass_fields__
            )
        )
        return ended.subset(ended.ray.argsort())

    def _step(self, walk: _Walk, any_hit: bool) -> None:
        """Every ray looks at its node and goes on to the next."""
        box = self._bounds[walk.node]
        first = (box[:, 0] - walk.origin) * walk.inverse
        second = (box[:, 1] - walk.origin) * walk.inverse
        enter = torch.minimum(first, second).amax(1).clamp(min=0)
        leave = torch.maximum(first, second).amin(1) * (1 + SLACK)
        inside = (enter <= torch.minimum(leave, walk.distance)) & (walk.node > 0)
        is_leaf = walk.node >= self._first_leaf
        rows = torch.nonzero(inside & is_leaf)[:, 0]
        if len(rows):
            self._meet(walk, rows)
        # The lower half of an axis is nearer to rays that run upwards along it.
        axis = self._axes[torch.where(is_leaf, 0, walk.node)]
        backwards = walk.direction.gather(1, axis[:, None])[:, 0] < 0
        child = 2 * walk.node + backwards
        lowest = walk.pending & -walk.pending
        height = torch.log2(lowest.clamp(min=1).double()).long()
        other = torch.where(lowest > 0, (walk.node >> height) ^ 1, 0)
        descend = inside & ~is_leaf
        if any_hit:
            other = torch.where(walk.face >= 0, 0, other)
        walk.node = torch.where(descend, child, other)
        walk.pending = torch.where(descend, 2 * walk.pending + 1, (walk.pending ^ lowest) >> height)

    def _meet(self, walk: _Walk, rows: Tensor) -> None:
        """Intersect some rays with the triangles of their leaves (Moeller and Trumbore, 1997)."""
        leaf = walk.node[rows] - self._first_leaf
        corner = self._leaves[leaf]
        direction = walk.direction[rows, None].expand(-1, corner.shape[1], -1)
        edge1, edge2 = corner[:, :, 1] - corner[:, :, 0], corner[:, :, 2] - corner[:, :, 0]
        across = torch.linalg.cross(direction, edge2)
        determinant = (edge1 * across).sum(2)
        scale = 1 / torch.where(determinant == 0, torch.inf, determinant)
        offset = walk.origin[rows, None] - corner[:, :, 0]
        u = (offset * across).sum(2) * scale
        turned = torch.linalg.cross(offset, edge1)
        v = (direction * turned).sum(2) * scale
        distance = (edge2 * turned).sum(2) * scale
        inside = (u >= -SLACK) & (v >= -SLACK) & (u + v <= 1 + SLACK)
        counts = inside & (determinant != 0) & (distance > 0)
        distance, slot = torch.where(counts, distance, torch.inf).min(1)
        better = distance < walk.distance[rows]
        rows, slot, leaf = rows[better], slot[better], leaf[better]
        walk.distance[rows] = distance[better]
        walk.face[rows] = leaf * corner.shape[1] + slot
        walk.u[rows] = u[better].gather(1, slot[:, None])[:, 0].clamp(0, 1)
        walk.v[rows] = v[better].gather(1, slot[:, None])[:, 0].clamp(0, 1)


def _halved(centres: Floats) -> tuple[NDArray[np.int64], int, NDArray[np.int64]]:
    """Order of the triangles in the leaves of a complete tree.

    Args:
        centres: (F, 3).

    Returns:
        Order (F,): leaf k of 2^depth holds the places k F / 2^depth up to the next; the depth; and
        the axis (2^depth,) across which each inner node is halved, by its number.
    """
    depth = max(0, int(np.ceil(np.log2(len(centres) / LEAF_SIZE))))
    order = np.arange(len(centres))
    axes = np.zeros(1 << depth, np.int64)
    for level in range(depth):
        count = 1 << level
        starts = np.arange(count) * len(order) // count
        sizes = np.diff(np.append(starts, len(order)))
        high = np.maximum.reduceat(centres[order], starts)
        low = np.minimum.reduceat(centres[order], starts)
        axes[count : 2 * count] = (high - low).argmax(1)
        axis = np.repeat(axes[count : 2 * count], sizes)
        order = order[np.lexsort((centres[order, axis], np.repeat(np.arange(count), sizes)))]
    return order, depth, axes


def _boxes(leaves: Floats) -> Floats:
    """Bounds (2 * L, 2, 3) of all nodes, low and high corner; node 0 is none.

    Args:
        leaves: (L, K, 3, 3), corners of the leaves' triangles.
    """
    count = len(leaves)
    bounds = np.zeros((2 * count, 2, 3), np.float32)
    bounds[count:, 0], bounds[count:, 1] = leaves.min((1, 2)), leaves.max((1, 2))
    while count > 1:
        count //= 2
        children = bounds[2 * count : 4 * count].reshape(count, 2, 2, 3)
        bounds[count : 2 * count, 0] = children[:, :, 0].min(1)
        bounds[count : 2 * count, 1] = children[:, :, 1].max(1)
    return bounds
