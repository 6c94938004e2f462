# SPDX-License-Identifier: Apache-2.0
"""Values stored in a texture, at points of the surface."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.floating[Any]]
Mask = NDArray[np.bool_]


def sample_texture(texture: Array, uv: Array, inside: Mask | None = None, cells: int = 1) -> Array:
    """Bilinear texture look-up; texels outside the charts take no part.

    Args:
        texture: (T, T, C), row 0 at v = 1, texel centres at half integers.
        uv: (N, 2) in [0, 1], v upwards.
        inside: (T, T) texels that hold something, or None for all. A point with none of them
            about it takes the nearest texel as it is.
        cells: Along a side of an atlas of tiles; a point takes texels of its own cell only.

    Returns:
        (N, C).
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
