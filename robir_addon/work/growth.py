# SPDX-License-Identifier: GPL-3.0-or-later
"""What a reconstruction makes of a capture so far.

As a picture: a photograph, and beside it the same view, as image and as icons. And as a surface,
where the capture is shown.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import bpy
import bpy.utils.previews
import numpy as np

from ..capture.growing import clear_surface, read_surface, show_surface
from ..gateway import JobPaths
from .worker import result_folder

PREVIEW = "RobIR preview"  # name of the image
_HALVES = ("photograph", "reconstruction")

_both: list[dict[str, Any]] = []  # Blender's collection of the two icons, once there is a picture
_STAGES_BEFORE = ("", "capture")
"""Stages in which a surface in the result folder is one of an earlier run."""

_changes: list[int] = [0]
"""How often a file was opened or something was undone, which may change the shown surface."""


@dataclass
class Growth:
    """What is shown of one reconstruction: when picture and surface were written, nanoseconds."""

    root: Path
    picture: int = 0
    surface: tuple[int, int] = (0, 0)

    def look(self, stage: str) -> bool:
        """Show what is newer than what is shown; whether the picture is another one."""
        paths = JobPaths(self.root)
        if stage not in _STAGES_BEFORE:
            self._look_at_surface(paths.growing)
        before, self.picture = self.picture, load_newer(paths.preview, self.picture)
        return self.picture != before

    def _look_at_surface(self, file: Path) -> None:
        try:
            written = file.stat().st_mtime_ns
        except OSError:  # none yet, or none in this run
            written = 0
        before, self.surface = self.surface, (written, _changes[0])
        if before == self.surface:
            return
        if not written:
            clear_surface()
            return
        found = [s for s in bpy.data.scenes if result_folder(s.robir) == self.root]
        surface = read_surface(file) if found else None
        if surface is not None:
            show_surface(found[0], surface)


def forget() -> None:
    """Take the image, the icons and the surface of an earlier reconstruction away."""
    _drop_icons()
    clear_surface()
    before = bpy.data.images.get(PREVIEW)
    if before is not None:
        bpy.data.images.remove(before)


def load_newer(path: Path, known: int) -> int:
    """Read a picture written after `known`, nanoseconds; when the shown one was written."""
    try:
        changed = path.stat().st_mtime_ns
    except OSError:
        return known
    if changed == known:
        return known
    image = bpy.data.images.get(PREVIEW)
    if image is None:
        try:
            image = bpy.data.images.load(str(path))
        except RuntimeError:  # removed or replaced this very moment; the next look tells
            return known
        image.name = PREVIEW
    else:
        image.reload()
    _refresh_icons(image)
    return changed


def icons() -> list[int]:
    """Icons of the photograph and of the reconstruction; none before there is a picture."""
    return [icon.icon_id for icon in _both[0].values()] if _both else []


def _drop_icons() -> None:
    while _both:
        bpy.utils.previews.remove(_both.pop())


def _look_again(*_: object) -> None:
    """A file or a step to undo may hold the surface as it was then, long after the work."""
    _changes[0] += 1
    if bpy.app.background:
        _clear_leftover()
    elif not bpy.app.timers.is_registered(_clear_leftover):
        # not while Blender is still putting the data in place
        bpy.app.timers.register(_clear_leftover, first_interval=0.0, persistent=True)


def _clear_leftover() -> None:
    if not bpy.context.window_manager.robir.job:
        clear_surface()


HANDLERS = tuple((name, _look_again) for name in ("load_post", "undo_post", "redo_post"))


def unregister() -> None:
    """Follow no longer, and give the icons back."""
    if bpy.app.timers.is_registered(_clear_leftover):
        bpy.app.timers.unregister(_clear_leftover)
    _drop_icons()


def _refresh_icons(image: bpy.types.Image) -> None:
    """Give the icons the pixels of the image's left and right half."""
    width, height = image.size
    if width < 2 or not height:
        return
    pixels = np.empty((height, width, 4), np.float32)
    image.pixels.foreach_get(pixels.reshape(-1))
    if not _both:
        icons_of = bpy.utils.previews.new()
        for half in _HALVES:
            icons_of.new(half)
        _both.append(icons_of)
    middle = width // 2
    for half, part in zip(_HALVES, (pixels[:, :middle], pixels[:, -middle:]), strict=True):
        icon = _both[0][half]
        icon.image_size = (middle, height)
        icon.image_pixels_float.foreach_set(np.ascontiguousarray(part).reshape(-1))
