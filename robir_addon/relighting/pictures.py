# SPDX-License-Identifier: GPL-3.0-or-later
"""Icons that show the object of a result under each of the lights to choose from."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import bpy
import bpy.utils.previews

from ..gateway import JobPaths
from .lights import SHOWN_LIGHTS

_known: dict[str, Any] = {}
"""Blender's collections of icons by the result's absolute path; the shown results only."""


def light_pictures(result: str) -> dict[str, int]:
    """Icons by the light's stem, "" the recovered light's; touches no file.

    Args:
        result: Result folder, as the settings have it.

    Returns:
        Nothing where no pictures were rendered.
    """
    icons = _known.get(bpy.path.abspath(result), {})
    return {stem: icons[stem].icon_id for stem, _, _ in SHOWN_LIGHTS if stem in icons}


def read_pictures(results: Iterable[str]) -> None:
    """Take up the pictures of some results, absolute paths; forget the others."""
    unregister()
    for result in results:
        paths = JobPaths(Path(result))
        files = {stem: paths.light_picture(stem) for stem, _, _ in SHOWN_LIGHTS}
        if not any(file.is_file() for file in files.values()):
            continue
        icons = _known[result] = bpy.utils.previews.new()
        for stem, file in files.items():
            if file.is_file():
                icons.load(stem, str(file), "IMAGE")


def unregister() -> None:
    """Give the icons back."""
    while _known:
        bpy.utils.previews.remove(_known.popitem()[1])
