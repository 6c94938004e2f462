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

Array = NDArray[np.floating]

SIDE = 24
"""Cells along each side of the map: 8 degrees wide in the middle, as fine as normals are known."""

CELLS = SIDE * SIDE
"""Cells of the map; this number itself stands for a direction that says nothing."""

GRAZING = 0.15
"""Cosine of the view below which a normal a few degrees off mirrors quite another direction."""

HELD = 20.0
"""Observations by which a cell is held to mirror nothing."""

ROUNDS = 12
"""Turns of solving spots and map after each other."""

LEAST_VIEWS = 3
"""Photographs that must show a spot from which the map is learnt."""


def mirrored_cells(normals: Array, towards: Array) -> NDArray[np.int64]:
    """Cells of the directions that points mirror, by an octahedral map.

    Meyer et al. 2010, "On floating-point normal vectors".

    Args:
        normals: (P, 3) unit.
        towards: (P, 3) unit, towards the camera.

    Returns:
        (P,); CELLS where the camera looks along the surface, or from behind it.
    """
    cosine = (normals * towards).sum(1, keepdims=True)
    mirrored = 2.0 * cosine * normals - towards
    flat = mirrored / np.maximum(np.abs(mirrored).sum(1, keepdims=True), 1e-9)
    x, y, z = flat.T
    signs = np.where(flat[:, :2] >= 0, 1.0, -1.0)
    folded = (1.0 - np.abs(flat[:, 1::-1])) * signs
    place = np.where((z < 0)[:, None], folded, np.stack([x, y], axis=1))
    row, column = np.clip(((place + 1.0) * (SIDE / 2)).astype(np.int64), 0, SIDE - 1).T
    return np.where(cosine[:, 0] > GRAZING, row * SIDE + column, CELLS)


def nothing_mirrored() -> Array:
    """The map (CELLS + 1, 3) of a surface that mirrors nothing."""
    return np.zeros((CELLS + 1, 3))


def learnt_map(colours: Array, seen: Array, cells: NDArray[np.int64]) -> Array:
    """What each direction adds to a spot's own colour, by alternating least squares.

    Args:
        colours: (P, J, 3) display colours that photographs show of points.
        seen: (P, J) 1 where a photograph does show the point, else 0.
        cells: (P, J) from `mirrored_cells`.

    Returns:
        (CELLS + 1, 3) display colours, about 0; the last one is 0.
    """
    known = seen.sum(1) >= LEAST_VIEWS
    colours, seen, cells = colours[known], seen[known], cells[known]
    count = np.bincount(cells.ravel(), seen.ravel(), CELLS + 1)[:, None]
    views = seen.sum(1)[:, None]
    result = nothing_mirrored()
    for _ in range(ROUNDS):
        own = ((colours - result[cells]) * seen[:, :, None]).sum(1) / views
        rest = (colours - own[:, None]) * seen[:, :, None]
        total = [
            np.bincount(cells.ravel(), part.ravel(), CELLS + 1) for part in rest.T.swapaxes(1, 2)
        ]
        result = np.stack(total, axis=1) / (count + HELD)
        result[CELLS] = 0.0
    return result
