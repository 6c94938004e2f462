# SPDX-License-Identifier: Apache-2.0
"""From a distance field to triangles and back to an exact distance."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt
from scipy.spatial import cKDTree
from skimage.measure import marching_cubes
from torch import Tensor

from robir.errors import QualityError
from robir.geometry.lattice import Lattice
from robir.geometry.mesh import Mesh, vertex_normals

EMPTY_UVS = np.zeros((0, 2), np.float32)
EMPTY_UV_FACES = np.zeros((0, 3), np.int32)


def plain_mesh(vertices: NDArray[np.floating], faces: NDArray[np.integer]) -> Mesh:
    """A mesh without texture coordinates, with area-weighted vertex normals.

    Args:
        vertices: (Nv, 3).
        faces: (Nf, 3), counter-clockwise seen from outside.

    Returns:
        The mesh.
    """
    vertices = np.ascontiguousarray(vertices, dtype=np.float32)
    faces = np.ascontiguousarray(faces, dtype=np.int32)
    return Mesh(
        vertices=vertices,
        faces=faces,
        normals=vertex_normals(vertices, faces),
        uvs=EMPTY_UVS,
        uv_faces=EMPTY_UV_FACES,
    )


def compacted(vertices: NDArray[np.floating], faces: NDArray[np.integer]) -> Mesh:
    """The mesh of some faces, without the vertices none of them uses."""
    used, inverse = np.unique(faces, return_inverse=True)
    return plain_mesh(vertices[used], inverse.reshape(-1, 3))


def extract(lattice: Lattice, sdf: Tensor) -> Mesh:
    """Zero level of a field by marching cubes, closed and counter-clockwise from outside.

    Args:
        lattice: Nodes.
        sdf: (N,) signed distances, negative inside.

    Returns:
        The mesh in the unit frame.

    Raises:
        QualityError: If the field has no surface.
    """
    grid = sdf.detach().cpu().view(lattice.shape).numpy().copy()
    for axis in range(3):  # closed: nothing may leave through the border
        for end in (0, -1):
            border = np.moveaxis(grid, axis, 0)[end]
            np.maximum(border, 0.5 * lattice.cell, out=border)
    if grid.min() >= 0:
        raise QualityError(
            "The geometry fit carved everything away: no surface is left. Check masks and poses."
        )
    vertices, faces, *_ = marching_cubes(
        grid, 0.0, spacing=(lattice.cell,) * 3, gradient_direction="descent"
    )
    placed = np.asarray(vertices, dtype=np.float64) + np.asarray(lattice.lower)
    return plain_mesh(placed, np.asarray(faces))


def distance_to_mesh(mesh: Mesh, lattice: Lattice) -> NDArray[np.float32]:
    """Signed distance to a closed mesh at the nodes of a lattice.

    Near the surface the distance is measured along the normal of the nearest of many surface
    points; the sign further off comes from flood filling, so an inverted vertex normal cannot
    turn a region inside out.

    Args:
        mesh: Closed mesh, normals outward.
        lattice: Nodes.

    Returns:
        Array of the lattice's shape, float32, negative inside.
    """
    points, normals = surface_points(mesh, 0.5 * lattice.cell)
    tree = cKDTree(points)
    nodes = lattice.nodes().numpy()
    scaled = np.round((points - lattice.lower) / lattice.cell).astype(int)
    scaled = np.clip(scaled, 0, np.asarray(lattice.shape) - 1)
    touched = np.zeros(lattice.shape, bool)
    touched[tuple(scaled.T)] = True
    far = np.asarray(distance_transform_edt(~touched))
    near = far.ravel() <= 3.0
    distance, nearest = tree.query(nodes[near])
    offset = nodes[near] - points[nearest]
    along = (offset * normals[nearest]).sum(1)
    side = np.where(along >= 0, 1.0, -1.0)
    inside_cell = distance < 1.5 * lattice.cell
    value = np.where(inside_cell, along, side * distance)
    out = (far * lattice.cell).astype(np.float32).ravel()
    sign = np.ones(lattice.count, np.float32)
    sign[near] = side
    sign = sign.reshape(lattice.shape)
    # nodes further off take the sign of the band node on their side of the surface
    rim = (far > 1.5) & (far <= 3.0)
    _, rim_source = distance_transform_edt(~rim, return_indices=True)
    distant = far > 3.0
    sign[distant] = sign[tuple(rim_source[:, distant])]
    out = out * sign.ravel()
    out[near] = value
    return out.reshape(lattice.shape)


def surface_points(mesh: Mesh, spacing: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Points on a mesh, at most about `spacing` apart, with interpolated normals.

    Args:
        mesh: The mesh.
        spacing: Largest wanted distance between neighbours, unit of the vertices.

    Returns:
        Points (P, 3) and unit normals (P, 3).
    """
    corners = mesh.vertices[mesh.faces].astype(np.float64)
    normals = mesh.normals[mesh.faces].astype(np.float64)
    edges = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    parts = np.maximum(np.ceil(edges / spacing), 1).astype(int)
    points_out, normals_out = [], []
    for count in np.unique(parts):
        faces = parts == count
        u, v = np.meshgrid(np.arange(count), np.arange(count), indexing="ij")
        u, v = (u + 1 / 3) / count, (v + 1 / 3) / count
        keep = u + v < 1.0
        share = np.stack([1.0 - u[keep] - v[keep], u[keep], v[keep]], axis=1)
        points_out.append(np.einsum("kc,fcd->fkd", share, corners[faces]).reshape(-1, 3))
        normals_out.append(np.einsum("kc,fcd->fkd", share, normals[faces]).reshape(-1, 3))
    points = np.concatenate(points_out)
    unit = np.concatenate(normals_out)
    unit /= np.maximum(np.linalg.norm(unit, axis=1, keepdims=True), 1e-12)
    return points, unit
