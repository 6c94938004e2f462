# SPDX-License-Identifier: GPL-3.0-or-later
"""Data-blocks that came from a result folder: how they are known, loaded and removed."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from .engine.errors import ResultError
from .gateway import UDIM, files_of

MARK = "robir_result"  # custom property that names the result folder a data-block came from
_UNREADABLE = "{file} cannot be read as an image; is it there and whole?"


def with_mark(blocks: bpy.types.bpy_prop_collection, mark: str) -> list[bpy.types.ID]:
    """Those of a kind of data-blocks that came from a result folder; linked ones are not ours."""
    return [b for b in blocks if b.library is None and b.get(MARK) == mark]


def remove_marked(mark: str, *kinds: bpy.types.bpy_prop_collection) -> None:
    """Remove the data-blocks of some kinds that came from a result folder."""
    for blocks in kinds:
        for block in with_mark(blocks, mark):
            blocks.remove(block)


def are_there(file: Path) -> bool:
    """Whether an image has its file, or one with tiles all that were written."""
    files = files_of(file)
    return bool(files) and all(one.is_file() for one in files)


def load_image(file: Path, space: str, mark: str) -> bpy.types.Image:
    """An image of its own, even where the user has loaded the same file; <UDIM> means tiles."""
    try:
        image = bpy.data.images.load(str((files_of(file) or [file])[0]), check_existing=False)
    except RuntimeError as fault:
        raise ResultError(_UNREADABLE, file=file) from fault
    if UDIM in file.name:
        image.source, image.filepath, image.name = "TILED", str(file), file.name
        _forget_other_tiles(image, file)
    sizes = [tile.size for tile in image.tiles] if image.source == "TILED" else [image.size]
    if any(0 in size for size in sizes):  # Blender finds damage only when asked about the pixels
        bpy.data.images.remove(image)
        raise ResultError(_UNREADABLE, file=file)
    image.colorspace_settings.name = space
    image[MARK] = mark
    return image


def reload_image(image: bpy.types.Image) -> None:
    """Read the pixels of a loaded image anew; who uses it goes on using it."""
    file, was_packed = Path(bpy.path.abspath(image.filepath)), image.packed_file is not None
    if not are_there(file):
        raise ResultError(_UNREADABLE, file=file)
    if was_packed:
        image.unpack(method="REMOVE")
    image.reload()
    if image.source == "TILED":
        _forget_other_tiles(image, file)
    if was_packed:
        image.pack()


def _forget_other_tiles(image: bpy.types.Image, file: Path) -> None:
    """Take from a tiled image what is no file of it: Blender looks at files of other kinds too."""
    numbers = {int(one.name.split(".")[-2]) for one in files_of(file)}
    known = {tile.number: tile for tile in image.tiles}
    for number in known.keys() - numbers:
        image.tiles.remove(known[number])


def numbers_of(elements: Any, name: str, width: int = 1, kind: type = np.float32) -> np.ndarray:
    """What the elements of a mesh have under a name, (N, width)."""
    values = np.empty(len(elements) * width, kind)
    elements.foreach_get(name, values)
    return values.reshape(-1, width)


def viewports(scene: bpy.types.Scene | None = None) -> list[bpy.types.Area]:
    """The 3D viewports of all windows, or of those that show a scene."""
    windows = bpy.context.window_manager.windows
    shown = [w for w in windows if scene is None or w.scene == scene]
    return [area for w in shown for area in w.screen.areas if area.type == "VIEW_3D"]


def enable_nodes(block: bpy.types.Material | bpy.types.World) -> None:
    """Give a material or a World its nodes."""
    if bpy.app.version < (5, 0, 0):  # later versions always have nodes and warn about the flag
        block.use_nodes = True


def select_alone(layer: bpy.types.ViewLayer, chosen: bpy.types.Object) -> None:
    """Make an object the active one, and the only one that is selected."""
    for other in filter(None, list(layer.objects.selected)):  # None is what was just removed
        other.select_set(False)
    chosen.select_set(True)
    layer.objects.active = chosen


@contextmanager
def only_selected(
    layer: bpy.types.ViewLayer,
    chosen: Sequence[bpy.types.Object],
    active: bpy.types.Object | None = None,
) -> Iterator[None]:
    """Select some objects and no others; afterwards the selection is as it was."""
    selected, before = list(layer.objects.selected), layer.objects.active
    try:
        for block in selected:
            block.select_set(False)
        for block in chosen:
            block.select_set(True)
        layer.objects.active = active or before
        yield
    finally:
        for block in chosen:
            block.select_set(block in selected)
        for block in selected:
            block.select_set(True)
        layer.objects.active = before
