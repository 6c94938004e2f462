# SPDX-License-Identifier: Apache-2.0
"""A mesh of quads, about as large as each other, along the directions in which a surface bends.

Jakob et al. 2015, "Instant Field-Aligned Meshes", by their library. All that follows knows
triangles: each quad is two of them, which Blender joins again (Tris to Quads).
"""

from __future__ import annotations

import importlib.util

import numpy as np
import trimesh

from robir.errors import ConfigError
from robir.geometry.mesh.child import arrays_from_child
from robir.geometry.mesh.isosurface import compacted
from robir.geometry.mesh.simplify import CREASE, distances_off
from robir.geometry.mesh.triangles import Mesh, face_geometry

_LIBRARY = "pyinstantmeshes"
# distance beyond which a vertex lies on a part that quads have lost (unit frame), and the share of
# the vertices that may, as rays miss some at edges
_LOST = 0.02
_MOST_LOST = 0.02
_PATIENCE = 600.0  # seconds of the clock
# All that the child process runs, as the library talks on its standard output. On several cores its
# result hangs on chance; Windows and macOS cannot be told to use one.
_CHILD = """
import os
import numpy as np
if hasattr(os, "sched_setaffinity"):
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
import pyinstantmeshes
with np.load(sys.argv[1], allow_pickle=False) as mesh:
    vertices, faces = pyinstantmeshes.remesh(
        mesh["vertices"], mesh["faces"], target_face_count=int(sys.argv[3]),
        crease_angle=float(sys.argv[4]), align_to_boundaries=True, deterministic=True)
np.savez(sys.argv[2], vertices=vertices, faces=faces)
"""


def refuse_without_library() -> None:
    """Refuse quads, by a `ConfigError`, where what makes them is not installed."""
    if importlib.util.find_spec(_LIBRARY) is None:
        raise ConfigError(
            f"geometry.quads needs {_LIBRARY}, which is not installed; "
            "run: pip install 'robir[quads]'"
        )


def quadrangulated(mesh: Mesh, face_budget: int) -> Mesh | None:
    """The surface in triangles, pairs of which are quads: as many as asked for, or more.

    Quads are of one size, so that thin parts need up to four times as many. None if even these lose
    a part.
    """
    for factor in (1, 2, 4):
        made = _remeshed(mesh, factor * face_budget)
        if made is not None and (distances_off(mesh, made) > _LOST).mean() <= _MOST_LOST:
            return made
    return None


def _remeshed(mesh: Mesh, count: int) -> Mesh | None:
    """About so many triangles in quads, or None if the library fails."""
    words = (str(count // 2), str(CREASE))
    arrays = arrays_from_child(mesh, _CHILD, words, _PATIENCE)
    if arrays is None:
        return None
    vertices, faces = arrays["vertices"], arrays["faces"]
    if not len(faces) or not np.isfinite(vertices).all():
        return None
    # the library leaves a triangle out where a face has five corners
    whole = trimesh.Trimesh(vertices, faces, process=False)
    trimesh.repair.fill_holes(whole)
    faces = np.asarray(whole.faces)
    _, areas = face_geometry(vertices, faces)
    return compacted(vertices, faces[areas > 0])
