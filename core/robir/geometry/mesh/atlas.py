# SPDX-License-Identifier: Apache-2.0
"""Values stored in a texture, at points of the surface."""

from __future__ import annotations

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
