# SPDX-License-Identifier: Apache-2.0
"""Directions: unit vectors, frames, spreads over the sphere and the lat-long map.

The lat-long (equirectangular) map follows Blender's World texture: z is up, the centre of the map
is +X, u = 0.25 is +Y, the top row is +Z:

    u = 1/2 - atan2(y, x) / (2 pi),    v = 1/2 - asin(z) / pi  (v = 0 at the top).

Pixel centres lie at half integers; a map of height H is 2H wide.
"""

from __future__ import annotations

import math

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

GOLDEN_ANGLE = math.pi * (3.0 - math.sqrt(5.0))


def dot(first: Tensor, second: Tensor) -> Tensor:
    """Inner product over the last axis, which is dropped; leading axes broadcast."""
    return (first * second).sum(-1)


def normalise(vector: Tensor, smallest: float = 1e-12) -> Tensor:
    """Unit vectors along the last axis; vectors shorter than `smallest` stay short, never NaN."""
    length = torch.linalg.vector_norm(vector, dim=-1, keepdim=True)
    return vector / length.clamp_min(smallest)


def reflect(direction: Tensor, normal: Tensor) -> Tensor:
    """Mirror image of a direction (..., 3), of any length, about a unit normal (..., 3).

    Both point away from the surface, as does the result.
    """
    return 2.0 * dot(normal, direction)[..., None] * normal - direction


def orthonormal_frame(normal: Tensor) -> tuple[Tensor, Tensor]:
    """Two unit tangents (..., 3) that complete unit normals to right-handed frames.

    Tangent x bitangent = normal. Without branches and stable for every normal; the tangents jump
    where z changes sign (Duff et al., Building an Orthonormal Basis, Revisited, JCGT 6(1), 2017,
    listing 3).
    """
    x, y, z = normal.unbind(-1)
    sign = torch.where(z >= 0.0, torch.ones_like(z), -torch.ones_like(z))
    a = -1.0 / (sign + z)
    b = x * y * a
    tangent = torch.stack([1.0 + sign * x * x * a, sign * b, -sign * x], dim=-1)
    bitangent = torch.stack([b, sign + y * y * a, -y], dim=-1)
    return tangent, bitangent


def tangents(axis: NDArray[np.floating]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Tangent and bitangent (3,) of one unit direction (3,), right-handed, by its least part."""
    tangent = np.cross(axis, np.eye(3)[np.abs(axis).argmin()])
    tangent /= np.linalg.norm(tangent)
    return tangent, np.cross(axis, tangent)


def ring(axis: NDArray[np.floating], radius: float, count: int, turn: float) -> NDArray[np.float64]:
    """Even unit directions (count, 3) on a circle at the angle `radius` about a unit axis (3,).

    The first lies `turn` along the circle; angles in radians.
    """
    tangent, bitangent = tangents(axis)
    angles = turn + np.arange(count) * 2 * np.pi / count
    return np.cos(radius) * axis + np.sin(radius) * (
        np.cos(angles)[:, None] * tangent + np.sin(angles)[:, None] * bitangent
    )


def fibonacci_sphere(count: int, *, dtype: torch.dtype = torch.float32) -> Tensor:
    """Near-uniform unit directions (count, 3) on a golden spiral, from +Z down to -Z.

    Each direction stands for the solid angle 4 pi / count; heights are the midpoints of equal
    slices, which makes means over them exact for functions linear in z. Angles are formed in
    float64.
    """
    index = torch.arange(count, dtype=torch.float64)
    z = 1.0 - (2.0 * index + 1.0) / count
    radius = torch.sqrt((1.0 - z * z).clamp_min(0.0))
    azimuth = GOLDEN_ANGLE * index
    return torch.stack([radius * azimuth.cos(), radius * azimuth.sin(), z], dim=-1).to(dtype)


def direction_from_uv(uv: Tensor) -> Tensor:
    """Unit directions (..., 3), world, z up, of lat-long coordinates (u left, v from the top)."""
    azimuth = (0.5 - uv[..., 0]) * (2.0 * math.pi)
    elevation = (0.5 - uv[..., 1]) * math.pi
    cosine = elevation.cos()
    return torch.stack([cosine * azimuth.cos(), cosine * azimuth.sin(), elevation.sin()], dim=-1)


def equirect_directions(
    height: int,
    *,
    rows: slice = slice(None),
    dtype: torch.dtype = torch.float32,
    device: torch.device | str = "cpu",
) -> Tensor:
    """Unit directions (H, 2H, 3) of the pixel centres of a lat-long map, row 0 on top.

    Of some `rows` only, if asked for. Angles are formed in float64.
    """
    row = ((torch.arange(height, dtype=torch.float64) + 0.5) / height)[rows]
    column = (torch.arange(2 * height, dtype=torch.float64) + 0.5) / (2 * height)
    v, u = torch.meshgrid(row, column, indexing="ij")
    return direction_from_uv(torch.stack([u, v], dim=-1)).to(device=device, dtype=dtype)


def equirect_solid_angles(
    height: int,
    *,
    rows: slice = slice(None),
    dtype: torch.dtype = torch.float32,
    device: torch.device | str = "cpu",
) -> Tensor:
    """Exact solid angles (H, 2H) in steradian of the pixels of a lat-long map; they sum to 4 pi.

    Of some `rows` only, if asked for. Formed in float64.
    """
    edge = torch.sin((0.5 - torch.arange(height + 1, dtype=torch.float64) / height) * math.pi)
    row = ((edge[:-1] - edge[1:]) * (math.pi / height))[rows]
    return row[:, None].repeat(1, 2 * height).to(device=device, dtype=dtype)


def farthest_points(
    positions: NDArray[np.floating], count: int, first: int = 0
) -> NDArray[np.int64]:
    """Rising indices of positions (N, 3) far from each other, each next the farthest from those.

    All if there are no more than `count`; fewer are a subset of more. It begins with the `first`.
    """
    if len(positions) <= count:
        return np.arange(len(positions))
    chosen = [first]
    nearest = np.linalg.norm(positions - positions[first], axis=1)
    while len(chosen) < count:
        chosen.append(int(nearest.argmax()))
        nearest = np.minimum(nearest, np.linalg.norm(positions - positions[chosen[-1]], axis=1))
    return np.sort(np.asarray(chosen))
