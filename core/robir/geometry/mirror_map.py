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

Array = NDArray[np.floating]


# cells along each side of the map; 24 are 8 degrees wide in the middle, as fine as normals are
# known
_SIDE = 24
# cosine of the view below which a normal a few degrees off mirrors quite another direction
_GRAZING = 0.15
_HELD = 20.0  # observations by which a cell is held to mirror nothing
_ROUNDS = 12  # turns of solving spots and map after each other
_LEAST_VIEWS = 3  # photographs that must show a spot from which the map is learnt


def mirrored_cells(normals: Array, towards: Array) -> NDArray[np.int64]:
    """Cells of the directions that points mirror, by an octahedral map.

    Meyer et al. 2010, "On floating-point normal vectors".

    Args:
        normals: (P, 3) unit.
        towards: (P, 3) unit, towards the camera.

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
    row, column = np.clip(((place + 1.0) * (_SIDE / 2)).astype(np.int64), 0, _SIDE - 1).T
    return np.where(cosine[:, 0] > _GRAZING, row * _SIDE + column, _SIDE * _SIDE)


def nothing_mirrored() -> Array:
    """The map (C + 1, 3) of a surface that mirrors nothing."""
    return np.zeros((_SIDE * _SIDE + 1, 3))


def learnt_map(colours: Array, seen: Array, cells: NDArray[np.int64]) -> Array:
    """What each direction adds to a spot's own colour, by alternating least squares.

    Args:
        colours: (P, J, 3) display colours that photographs show of points.
        seen: (P, J) 1 where a photograph does show the point, else 0.
        cells: (P, J) from `mirrored_cells`.

    Returns:
        (C + 1, 3) display colours, about 0; the last one is 0.
    """
    known, number = seen.sum(1) >= _LEAST_VIEWS, _SIDE * _SIDE
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
    result = nothing_mirrored()
    for _ in range(_ROUNDS):
        own = (by_point - mirrors @ result) / views
        result = (by_cell - mirrors.T @ own) / (count + _HELD)
        result[number] = 0.0
    return result
