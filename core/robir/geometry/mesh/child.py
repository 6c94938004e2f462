# SPDX-License-Identifier: Apache-2.0
"""Runs what makes arrays of a mesh in a process of its own: it may hang, crash or talk."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robir.geometry.mesh.triangles import Mesh

# modules are found where this process finds them; "sys" needs no search
_FIRST = "import sys; sys.path[:0] = sys.argv.pop().split('\\n')\n"


def arrays_from_child(
    mesh: Mesh, code: str, words: tuple[str, ...], patience: float
) -> dict[str, NDArray[Any]] | None:
    """Arrays that code for Python writes, or None where it fails or takes too long.

    Its arguments are the file to read, .npz with `vertices` and `faces`, the .npz to write, and
    `words`; `patience` is seconds of the clock.
    """
    with tempfile.TemporaryDirectory(prefix="robir-mesh-") as folder:
        source, target = Path(folder, "mesh.npz"), Path(folder, "made.npz")
        np.savez(source, vertices=mesh.vertices, faces=mesh.faces)
        paths = "\n".join(entry for entry in sys.path if entry)
        command = [sys.executable, "-c", _FIRST + code, str(source), str(target), *words, paths]
        try:
            ended = subprocess.run(command, timeout=patience, capture_output=True, check=False)
        except subprocess.TimeoutExpired:
            return None
        if ended.returncode != 0 or not target.exists():
            return None
        with np.load(target, allow_pickle=False) as arrays:
            return dict(arrays)
