# SPDX-License-Identifier: Apache-2.0
"""Surface samples ("surfels"): where transport is baked and the light is solved."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from robir.geometry.mesh.triangles import Mesh
from robir.workers import num_workers

Floats = NDArray[np.float32]

# how far apart two samples with opposite normals count, in unit-frame lengths: a nearest-sample
# query must not reach through a thin wall
NORMAL_REACH = 0.5

# cell, in spacings of the samples and in unit normals, whose points share a nearest sample: they
# lie 3 % further from it than from their own on average
SHARED_CELL = 0.25


@dataclass(frozen=True, slots=True, kw_only=True)
class Surfels:
    """Even samples of the surface, unit frame."""

    position: Floats  # (S, 3) float32
    normal: Floats  # (S, 3) float32, unit, outward, interpolated from the vertices
    spacing: float  # typical distance between neighbours

    def __len__(self) -> int:
        """Number of samples."""
        return len(self.position)

    def subset(self, keep: NDArray[np.bool_]) -> Surfels:
        """The samples where `keep` holds."""
        return Surfels(position=self.position[keep], normal=self.normal[keep], spacing=self.spacing)

    def nearest(self, position: Floats, normal: Floats, count: int = 1) -> NDArray[np.int64]:
        """Indices (N,), or (N, count), of the samples nearest in position and orientation."""
        scale = NORMAL_REACH / 2
        tree = cKDTree(np.concatenate([self.position, scale * self.normal], axis=1))
        query = np.concatenate([position, scale * normal], axis=1)
        return tree.query(query, k=count, workers=num_workers())[1]

    def shared_nearest(self, position: Floats, normal: Floats) -> NDArray[np.int64]:
        """Samples (N,) as `nearest`, in less than half its time where points (N, 3) crowd.

        Points in one cell of SHARED_CELL that face alike take the sample of one of them.
        """
        key = np.zeros(len(position), np.int64)
        sides = (SHARED_CELL * self.spacing, SHARED_CELL)
        for values, side in zip((position, normal), sides, strict=True):
            for column in values.T:
                cell = np.floor(column / side).astype(np.int64)
                cell -= cell.min(initial=0)
                key = key * (cell.max(initial=0) + 1) + cell
        _, one, of_cell = np.unique(key, return_index=True, return_inverse=True)
        return self.nearest(position[one], normal[one])[of_cell]


def interpolate(mesh: Mesh, face: NDArray[np.int32], barycentric: Floats) -> tuple[Floats, Floats]:
    """Positions and smooth unit normals (N, 3) at points of faces (N,)."""
    corners = mesh.faces[face]
    position = np.einsum("nc,ncd->nd", barycentric, mesh.vertices[corners])
    normal = np.einsum("nc,ncd->nd", barycentric, mesh.normals[corners])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    return position.astype(np.float32), normal.astype(np.float32)


def sample_surfels(mesh: Mesh, count: int, rng: np.random.Generator) -> Surfels:
    """About `count` samples spread evenly over a mesh, unit frame, by area.

    Many uniform samples are drawn and binned by position and orientation; the one nearest to its
    bin's mean is kept, which is close to blue noise.
    """
    corners = mesh.vertices[mesh.faces].astype(np.float64)
    doubled = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = 0.5 * np.linalg.norm(doubled, axis=1)
    num_drawn = 10 * count
    face = rng.choice(len(area), size=num_drawn, p=area / area.sum()).astype(np.int32)
    root = np.sqrt(rng.random(num_drawn))
    second = rng.random(num_drawn)
    barycentric = np.stack([1 - root, root * (1 - second), root * second], axis=1)
    position, normal = interpolate(mesh, face, barycentric.astype(np.float32))
    # A plane cuts about 1.5 cells of side h for each h^2 of its area, whatever its tilt.
    spacing = float(np.sqrt(1.5 * area.sum() / count))
    cell = np.floor(position / spacing).astype(np.int64)
    facing = np.abs(normal).argmax(1) * 2 + (
        np.take_along_axis(normal, np.abs(normal).argmax(1)[:, None], 1)[:, 0] > 0
    )
    key = ((cell[:, 0] * 8191 + cell[:, 1]) * 8191 + cell[:, 2]) * 6 + facing
    _, group, size = np.unique(key, return_inverse=True, return_counts=True)
    mean = np.stack([np.bincount(group, position[:, axis]) / size for axis in range(3)], axis=1)
    offset = np.linalg.norm(position - mean[group], axis=1)
    order = np.lexsort((offset, group))
    first = order[np.searchsorted(group[order], np.arange(len(size)))]
    first = first[size >= 2]
    return Surfels(position=position[first], normal=normal[first], spacing=spacing)
