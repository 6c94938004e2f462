# SPDX-License-Identifier: GPL-3.0-or-later
"""The lights to choose from, each with a picture of the result's object under it."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import bpy
import bpy.utils.previews

from ..gateway import JobPaths
from ..words import words
from .lights import SHOWN_LIGHTS

RECOVERED = "recovered"  # identifier of the light of the photographs
_MAPS = (".exr", ".hdr")

_known: dict[str, Any] = {}
"""Blender's collections of icons by the result's absolute path, and by folders of own maps."""

_items: dict[str, list[tuple[str, str, str, int, int]]] = {}
"""Choices as Blender was told last, which keeps no strings of its own."""


def light_pictures(result: str) -> dict[str, int]:
    """Icons by the light's stem, "" the recovered light's; touches no file."""
    icons = _known.get(bpy.path.abspath(result), {})
    return {stem: icons[stem].icon_id for stem, _, _ in SHOWN_LIGHTS if stem in icons}


def light_items(settings: Any, _context: object) -> list[tuple[str, str, str, int, int]]:
    """The choices as an enumeration has them: a path stands for a map of the user's own."""
    pictures, own = light_pictures(settings.result), _own_maps(settings.light_folder)
    shipped = [
        (stem or RECOVERED, words(name), words(about), pictures.get(stem, 0), number)
        for number, (stem, name, about) in enumerate(SHOWN_LIGHTS)
    ]
    maps = [
        (file, Path(file).stem, file, icon.icon_id, len(shipped) + number)
        for number, (file, icon) in enumerate(own.items())
    ]
    key = bpy.path.abspath(settings.result)
    _items[key] = [*shipped, *maps]
    return _items[key]


def _own_maps(folder: str) -> dict[str, Any]:
    """Icons of the maps in a folder by their paths; the folder is read once."""
    if folder and folder not in _known:
        icons = _known[folder] = bpy.utils.previews.new()
        place = Path(bpy.path.abspath(folder))
        for file in sorted(f for f in place.glob("*") if f.suffix.lower() in _MAPS):
            icons.load(str(file), str(file), "IMAGE")
    return _known.get(folder, {})


def read_pictures(results: Iterable[str]) -> None:
    """Take up the pictures of some results, absolute paths; forget all others."""
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
