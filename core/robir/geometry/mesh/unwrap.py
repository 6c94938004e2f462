# SPDX-License-Identifier: Apache-2.0
"""Texture coordinates: xatlas in a process of its own, with a time-out and a plain fallback."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from robir.constants import applied
from robir.errors import StorageError
from robir.geometry.mesh.charts import ATLAS_SIZE, GUTTER
from robir.geometry.mesh.child import arrays_from_child
from robir.geometry.mesh.simplify import decimate
from robir.geometry.mesh.triangles import Mesh

_CHILD = "from robir.geometry.mesh.charts import main; main(*sys.argv[1:])"
_CLOCK_FACTOR = 8  # seconds of the clock that a second of processor time may take on a busy machine


def _in_child(mesh: Mesh, seconds: float) -> tuple[NDArray[np.float32], NDArray[np.int32]] | None:
    """Charts made in a child process, or None if it takes too long or fails."""
    # other modules than these would load torch there
    constants = [one for one in applied if one.startswith("geometry.mesh.")]
    words = (str(seconds), json.dumps(constants))
    made = arrays_from_child(mesh, _CHILD, words, seconds * _CLOCK_FACTOR)
    if made is None:
        return None
    uvs, uv_faces = made["uvs"], made["uv_faces"]
    usable = len(uv_faces) == len(mesh.faces) and bool(np.isfinite(uvs).all())
    return (uvs, uv_faces) if usable else None


def triangle_charts(count: int) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    """An atlas without charts: two triangles share each square of a regular grid."""
    squares = math.ceil(math.sqrt(math.ceil(count / 2)))
    face = np.arange(count)
    square, second = face // 2, face % 2
    corner = np.stack([square % squares, square // squares], axis=1)
    gap = min(0.2, GUTTER * squares / ATLAS_SIZE / 2)
    low = np.array([[gap, gap], [1.0 - 3 * gap, gap], [gap, 1.0 - 3 * gap]])
    shape = np.where(second[:, None, None] == 0, low, 1.0 - low)
    uvs = (corner[:, None, :] + shape) / squares
    indices = np.arange(3 * count, dtype=np.int32).reshape(-1, 3)
    return uvs.reshape(-1, 2).astype(np.float32), indices


def unwrap(mesh: Mesh, seconds: float, warn: Callable[[str], None]) -> Mesh:
    """Give a mesh texture coordinates, at worst with fewer faces or a place for each.

    `seconds` is the longest processor time of one attempt; `warn` is told what was given up.
    """
    charts = _in_child(mesh, seconds)
    for _ in range(2):
        if charts is not None:
            break
        budget = len(mesh.faces) // 2
        warn(
            f"Unwrapping {len(mesh.faces)} faces did not end within {seconds:g} s; "
            f"trying again with {budget} faces."
        )
        mesh = decimate(mesh, budget)
        charts = _in_child(mesh, seconds)
    if charts is None:
        warn(
            "Unwrapping failed three times; every triangle got its own place in the texture. "
            "The asset renders as usual, but its texture is hard to paint on."
        )
        charts = triangle_charts(len(mesh.faces))
    return replace(mesh, uvs=charts[0], uv_faces=charts[1])


def rasterise_atlas(mesh: Mesh, size: int) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
    """Face (size, size) int32 of every texel, -1 for none, and barycentric coordinates, 0 there.

    Row 0 is the top, v = 1; texel centres lie at half integers. `StorageError` if no face lies on
    any texel.
    """
    corners = mesh.uvs[mesh.uv_faces].astype(np.float64) * size
    corners[..., 1] = size - corners[..., 1]
    face_index = np.full((size, size), -1, np.int32)
    barycentric = np.zeros((size, size, 3), np.float32)
    low = np.clip(np.ceil(corners.min(axis=1) - 0.5), 0, size).astype(int)
    high = np.clip(np.floor(corners.max(axis=1) - 0.5) + 1, 0, size).astype(int)
    extent = np.maximum(high - low, 0)
    area = extent[:, 0] * extent[:, 1]
    order = np.flatnonzero(area)
    for part in np.array_split(order, max(1, math.ceil(area.sum() / 2_000_000))):
        face = np.repeat(part, area[part])
        within = np.arange(len(face)) - np.repeat(np.cumsum(area[part]) - area[part], area[part])
        column = low[face, 0] + within % extent[face, 0]
        row = low[face, 1] + within // extent[face, 0]
        a, b, c = (corners[face, k] for k in range(3))
        point = np.stack([column + 0.5, row + 0.5], axis=1)
        total = plane_cross(b - a, c - a)
        total = np.where(np.abs(total) < 1e-12, np.inf, total)
        share = np.stack(
            [
                plane_cross(b - point, c - point),
                plane_cross(c - point, a - point),
                plane_cross(a - point, b - point),
            ],
            axis=1,
        )
        share /= total[:, None]
        inside = (share >= -1e-9).all(axis=1) & np.isfinite(total)
        face_index[row[inside], column[inside]] = face[inside]
        barycentric[row[inside], column[inside]] = share[inside]
    if (face_index < 0).all():
        raise StorageError(
            "The mesh's texture coordinates fill no texel: run the geometry stage again."
        )
    return face_index, barycentric


def plane_cross(one: NDArray[np.float64], two: NDArray[np.float64]) -> NDArray[np.float64]:
    """Cross products (N,) of plane vectors (N, 2)."""
    return one[:, 0] * two[:, 1] - one[:, 1] * two[:, 0]
