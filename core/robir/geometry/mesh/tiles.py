# SPDX-License-Identifier: Apache-2.0
"""UDIM tiles: texture coordinates over several unit squares, kept as the cells of one square atlas.

Tile 1001 + i + 10 j holds u in [i, i + 1] and v in [j, j + 1], i at most 9 (Mari, Foundry). The
tiles of a mesh, in the order of their numbers, are cells of an atlas of n by n, n the least whole
number whose square is enough for them, row by row from v = 0:

    atlas = (cell + own - corner of the tile) / n

so that whatever works on an atlas works on tiles. A mesh without tiles has an atlas of one cell.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.floating[Any]]
Mask = NDArray[np.bool_]


def sample_texture(texture: Array, uv: Array, inside: Mask | None = None, cells: int = 1) -> Array:
    """Bilinear look-up (N, C) in a texture (T, T, C), row 0 at v = 1, at (N, 2) in [0, 1], v up.

    Texels that are not `inside` (T, T) take no part; a point with none about it takes the nearest
    texel as it is. In an atlas with so many `cells` along a side, it takes texels of its own cell
    only.
    """
    size = np.array(texture.shape[1::-1])
    own = size // cells
    place = np.stack([uv[:, 0], 1.0 - uv[:, 1]], axis=1) * size - 0.5
    low = np.floor(place).astype(np.int64)
    part = place - low
    first = np.clip(np.floor(place + 0.5).astype(np.int64) // own, 0, cells - 1) * own
    last = first + own - 1
    total, weight_sum = np.zeros((len(uv), texture.shape[2])), np.zeros((len(uv), 1))
    for dx in (0, 1):
        for dy in (0, 1):
            x = np.clip(low[:, 0] + dx, first[:, 0], last[:, 0])
            y = np.clip(low[:, 1] + dy, first[:, 1], last[:, 1])
            weight = np.abs(1 - dx - part[:, 0]) * np.abs(1 - dy - part[:, 1])
            if inside is not None:
                weight = weight * inside[y, x]
            total += weight[:, None] * texture[y, x]
            weight_sum += weight[:, None]
    x, y = np.clip(np.round(place).astype(np.int64), first, last).T
    return np.where(weight_sum > 1e-6, total / np.maximum(weight_sum, 1e-6), texture[y, x])


Floats = NDArray[np.floating[Any]]
Whole = NDArray[np.integer[Any]]

FIRST = 1001
ACROSS = 10  # tiles of a row; the next row's numbers follow

ROWS = 100  # rows of tiles that Blender and others know: the last number is 2000


def cells_along(count: int) -> int:
    """Cells n along a side of the atlas that holds some number of tiles; 1 for none."""
    return math.isqrt(max(count, 1) - 1) + 1


def numbers_of(corners: Whole) -> NDArray[np.int32]:
    """Numbers (N,) of the tiles whose lower left corners are (i, j), (N, 2)."""
    return (FIRST + corners[:, 0] + ACROSS * corners[:, 1]).astype(np.int32)


def corners_of(numbers: Whole) -> NDArray[np.int32]:
    """Lower left corners (i, j), (N, 2), of the tiles of some numbers (N,)."""
    column, row = (numbers - FIRST) % ACROSS, (numbers - FIRST) // ACROSS
    return np.stack([column, row], axis=1).astype(np.int32)


def cells_of(count: int) -> NDArray[np.int32]:
    """Column and row (N, 2), from u = v = 0, of the cells that so many tiles take; one for none."""
    row, column = np.divmod(np.arange(max(count, 1)), cells_along(count))
    return np.stack([column, row], axis=1).astype(np.int32)


def packed(places: Floats, tile: Whole, count: int) -> NDArray[np.float32]:
    """Coordinates (N, 2) of the atlas, from places (N, 2) within the tiles (N,) of `count`."""
    whole = (cells_of(count)[tile] + places) / cells_along(count)
    return whole.astype(np.float32)


def within(uvs: Floats, tile: Whole, count: int) -> NDArray[np.float32]:
    """Places (N, 2) in [0, 1] within their tiles: the inverse of `packed`."""
    places = uvs.astype(np.float64) * cells_along(count) - cells_of(count)[tile]
    return np.clip(places, 0.0, 1.0).astype(np.float32)


def tile_of_faces(uvs: Floats, uv_faces: Whole, count: int) -> NDArray[np.int64]:
    """Which tile (Nf,) each face of an atlas lies in by its middle; 0 without tiles."""
    if not count:
        return np.zeros(len(uv_faces), np.int64)
    side = cells_along(count)
    middle = uvs[uv_faces].astype(np.float64).mean(axis=1) * side
    column, row = np.clip(middle.astype(np.int64), 0, side - 1).T
    return row * side + column


def cell(image: NDArray[Any], tile: int, count: int) -> NDArray[Any]:
    """The part of an atlas' image (T, T) or (T, T, C), row 0 at v = 1, that a tile has."""
    side = len(image) // cells_along(count)
    column, row = (side * cells_of(count)[tile]).tolist()
    top = len(image) - row - side
    return image[top : top + side, column : column + side]
