# SPDX-License-Identifier: Apache-2.0
"""How many texels the photographs fill: one for each pixel of the view that sees a spot best."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from robir.appearance.config import AppearanceConfig
from robir.capture.camera import Camera
from robir.geometry.mesh.triangles import Mesh
from robir.transport.baked import Transport

_MOST_TOGETHER = 8192  # along a side of an atlas of UDIM tiles: what memory is planned for (texels)


def solved_side(config: AppearanceConfig, cells: int = 1) -> int:
    """Texels along a side of the atlas that is solved: no more than the textures may have.

    `cells` are along a side of an atlas of UDIM tiles, each of which has a power of two.
    """
    if cells == 1:
        return min(config.shading_size, config.texture_size)
    wanted = 2 ** round(math.log2(max(1.0, config.shading_size / cells)))
    return min(cells * wanted, most_side(config, cells))


def most_side(config: AppearanceConfig, cells: int = 1) -> int:
    """Most texels along a side of the atlas; all UDIM tiles together have `_MOST_TOGETHER`."""
    if cells == 1:
        return config.texture_size
    most = _MOST_TOGETHER / cells
    return cells * 2 ** int(math.log2(min(config.texture_size, most)))


def pixel_width(transport: Transport, cameras: Mapping[str, Camera]) -> float:
    """Median width on the surface, unit frame, of a pixel of the view that shows a spot best.

    Cameras have the size that photographs are read at; infinite if no view shows anything.
    """
    seen = transport.observations
    best = np.full(len(seen.weight), np.inf)
    for column, name in enumerate(seen.views):
        camera = cameras[name]
        depth = (transport.surfels.position - camera.position) @ camera.forward
        cosine = seen.weight[:, column]
        shown = cosine > 0
        area = depth[shown] ** 2 / (camera.fx * camera.fy * cosine[shown])
        best[shown] = np.minimum(best[shown], area)
    known = best[np.isfinite(best)]
    return math.sqrt(float(np.median(known))) if len(known) else math.inf


def texture_side(mesh: Mesh, width: float, sizes: tuple[int, int]) -> int:
    """Side of a square texture whose texels are no wider than `width` on an unwrapped mesh.

    The least of `sizes` doubled as often as it takes, and at most the most.
    """
    a, b, c = (mesh.vertices[mesh.faces[:, k]].astype(np.float64) for k in range(3))
    area = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1).sum()
    u, v, w = (mesh.uvs[mesh.uv_faces[:, k]].astype(np.float64) for k in range(3))
    (ax, ay), (bx, by) = (v - u).T, (w - u).T
    filled = 0.5 * np.abs(ax * by - ay * bx).sum()
    wanted = math.sqrt(area / max(filled, 1e-9)) / width
    least, most = sizes
    side = min(least, most)
    while side < wanted and 2 * side <= most:
        side *= 2
    return side
