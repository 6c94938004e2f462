# SPDX-License-Identifier: Apache-2.0
"""What a surface mirrors, as one map of the mirrored direction, learnt from photographs.

A polished thing shows every photograph another colour of the same spot, and a surface full of pits
explains that as well as any. But on the surface that is right all spots mirror one surroundings: a
map learnt at some spots, from some photographs, tells what others show.

Batch letters: P points, J photographs, C cells of the map.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from robir.geometry.step_config import MirrorMapConfig

Array = NDArray[np.floating]


def mirrored_cells(normals: Array, towards: Array, config: MirrorMapConfig) -> NDArray[np.int64]:
    """Cells of the directions that points mirror, by an octahedral map.

    Meyer et al. 2010, "On floating-point normal vectors".

    Args:
        normals: (P, 3) unit.
        towards: (P, 3) unit, towards the camera.
        config: Of the map.

    Returns:
        (P,); the number of cells where the camera looks along the surface, or from behind it.
    """
    cosine = (normals * towards).sum(1, keepdims=True)
    mirrored = 2.0 * cosine * normals - towards
    flat = mirrored / np.maximum(np.abs(mirrored).sum(1, keepdims=True), 1e-9)
    x, y, z = flat.T
    signs = np.where(flat[:, :2] >= 0, 1.0, -1.0)
    folded = (1.0 - np.abs(flat[:, 1::-1])) * signs
    place = np.where((z < 0)[:, None], folded, np.stack([x, y], axis=1))
    side = config.side
    row, column = np.clip(((place + 1.0) * (side / 2)).astype(np.int64), 0, side - 1).T
    return np.where(cosine[:, 0] > config.grazing, row * side + column, config.cells)


def nothing_mirrored(cells: int) -> Array:
    """The map (cells + 1, 3) of a surface that mirrors nothing."""
    return np.zeros((cells + 1, 3))


def learnt_map(
    colours: Array, seen: Array, cells: NDArray[np.int64], config: MirrorMapConfig
) -> Array:
    """What each direction adds to a spot's own colour, by alternating least squares.

    Args:
        colours: (P, J, 3) display colours that photographs show of points.
        seen: (P, J) 1 where a photograph does show the point, else 0.
        cells: (P, J) from `mirrored_cells`.
        config: Of the map.

    Returns:
        (C + 1, 3) display colours, about 0; the last one is 0.
    """
    known, number = seen.sum(1) >= config.least_views, config.cells
    seen, cells = seen[known].astype(np.float64), cells[known]
    shown = colours[known] * seen[:, :, None]
    point, photograph = np.nonzero(seen)
    place = point, cells[point, photograph]
    # (P, C + 1): how often a point mirrors a cell
    mirrors = sparse.csr_array((np.ones(len(point)), place), shape=(len(seen), number + 1))
    by_point, views = shown.sum(1), seen.sum(1)[:, None]
    by_cell = np.stack(
        [np.bincount(place[1], part, number + 1) for part in shown[point, photograph].T], axis=1
    )
    count = mirrors.sum(0)[:, None]
    result = nothing_mirrored(number)
    for _ in range(config.rounds):
        own = (by_point - mirrors @ result) / views
        result = (by_cell - mirrors.T @ own) / (count + config.held)
        result[number] = 0.0
    return result
