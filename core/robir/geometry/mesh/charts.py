# SPDX-License-Identifier: Apache-2.0
"""Charts by xatlas, joined and packed: all that the child process of `unwrap` needs."""

from __future__ import annotations

import json
import math
from contextlib import suppress
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robir.constants import changed

ATLAS_SIZE = 1024  # of the atlas the charts are packed for; sets the gutter between them (pixels)
GUTTER = 3  # between charts in that atlas (pixels)
_MOST_COST = 8.0  # of a chart, as xatlas counts it: more makes larger charts of more distortion


def xatlas_charts(
    vertices: NDArray[np.float32], faces: NDArray[np.int32]
) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    """Texture coordinates (Nu, 2), v upwards, and their indices (Nf, 3), however long it takes."""
    # here, because only the child process needs them
    import xatlas

    from robir.geometry.mesh.merging import merged_charts

    def packed(charts: xatlas.ChartOptions, *mesh: Any) -> tuple[Any, Any]:
        packing = xatlas.PackOptions()
        packing.resolution = ATLAS_SIZE
        packing.padding = GUTTER
        packing.bilinear = True
        packing.bruteForce = False
        atlas = xatlas.Atlas()
        atlas.add_mesh(*mesh)
        atlas.generate(chart_options=charts, pack_options=packing)
        _, uv_faces, uvs = atlas[0]
        return uvs.astype(np.float32), uv_faces.astype(np.int32)

    options = xatlas.ChartOptions()
    options.max_iterations = 1
    options.max_cost = _MOST_COST
    first = packed(options, vertices, faces.astype(np.uint32))
    uvs, uv_faces = merged_charts(vertices, faces, first)
    place = np.zeros(len(uvs), np.int64)
    place[uv_faces] = faces
    options.use_input_mesh_uvs = True
    # without normals: these would only split what has been joined
    uvs = np.ascontiguousarray(uvs, np.float32)
    return packed(options, vertices[place], uv_faces.astype(np.uint32), None, uvs)


def main(source: str, target: str, seconds: str, constants: str) -> None:
    """Entry of the child process: read vertices and faces, write texture coordinates.

    On a busy machine a second of the clock says nothing, so the system ends the process by its
    processor time where there is such a limit; Windows has none.
    """
    with suppress(ImportError):
        import resource

        limit = math.ceil(float(seconds))
        resource.setrlimit(resource.RLIMIT_CPU, (limit, limit))
    with np.load(source, allow_pickle=False) as arrays, changed(json.loads(constants)):
        uvs, uv_faces = xatlas_charts(arrays["vertices"], arrays["faces"])
    np.savez(target, uvs=uvs, uv_faces=uv_faces)
