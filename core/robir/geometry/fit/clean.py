# SPDX-License-Identifier: Apache-2.0
"""Removal of pieces the photographs do not support, return of parts they demand."""

from __future__ import annotations

import numpy as np
import scipy.sparse
import torch
from scipy.sparse.csgraph import connected_components
from torch import Tensor

from robir.geometry.fit.field import Field
from robir.geometry.lattice import taken
from robir.geometry.mesh.isosurface import compacted
from robir.geometry.mesh.triangles import Mesh
from robir.geometry.rays import RaySampler

_BATCHES = 40  # batches of 2048 rays that are searched for missing parts
_LEAST_SHARE = 0.02  # pieces with less than this share of the largest piece's area are removed


def largest_pieces(mesh: Mesh) -> Mesh:
    """Keep the pieces that are not small against the largest one."""
    faces = mesh.faces
    graph = scipy.sparse.coo_matrix(
        (np.ones(2 * len(faces)), (faces[:, [0, 1]].ravel(), faces[:, [1, 2]].ravel())),
        shape=(len(mesh.vertices),) * 2,
    )
    _, piece = connected_components(graph, directed=False)
    corners = mesh.vertices[faces].astype(np.float64)
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    of_face = piece[faces[:, 0]]
    area = np.bincount(of_face, weights=np.linalg.norm(cross, axis=1))
    return compacted(mesh.vertices, faces[area[of_face] >= _LEAST_SHARE * area.max()])


def restore_missing(field: Field, hull: Tensor, sampler: RaySampler) -> Tensor:
    """Bring back from the hull what the fit lost although the masks show it.

    A thin part that is smoothed away at a coarse level leaves no surface that a gradient could
    pull on. Rays inside the masks that meet nothing find it again.

    Args:
        field: Field of the present level.
        hull: (N,) signed distance of the visual hull on the field's lattice.
        sampler: Source of rays.

    Returns:
        The new signed distances (N,).
    """
    lattice, sdf = field.lattice, field.sdf.detach()
    marked = torch.zeros(lattice.count, dtype=torch.bool, device=sdf.device)
    steps = torch.arange(0.0, 2.2, 1.4 * lattice.cell, device=sdf.device)
    for _ in range(_BATCHES):
        origins, directions, target = sampler.draw(2048)
        solid = target[:, 3] > 0.95
        origins, directions = origins[solid], directions[solid]
        begin = -(origins * directions).sum(1, keepdim=True) - 1.1
        along = begin + steps
        lines = zip(origins.unbind(1), directions.unbind(1), strict=True)
        planes = [start[:, None] + along * slope[:, None] for start, slope in lines]
        nodes = lattice.nearest(torch.stack(planes).movedim(0, -1))
        nodes = nodes[(taken(sdf, nodes) >= 2.0 * lattice.cell).all(1)].view(-1)
        marked[nodes[hull[nodes] < 0.5 * lattice.cell]] = True
    return torch.where(lattice.dilated(marked, 2), torch.minimum(sdf, hull), sdf)
