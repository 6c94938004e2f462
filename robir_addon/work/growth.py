# SPDX-License-Identifier: GPL-3.0-or-later
"""What a reconstruction makes of a capture so far.

As a picture: a photograph, and beside it the same view, as image and as icons. And as a surface,
where the capture is shown.
"""

import io
import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import bpy
import bpy.utils.previews
import numpy as np

from ..capture.viewport import MARK
from ..gateway import JobPaths, read_regular
from .worker import result_folder

PREVIEW = "RobIR preview"  # name of the image
_HALVES = ("photograph", "reconstruction")
_both: list[dict[str, Any]] = []  # Blender's collection of the two icons, once there is a picture
# stages in which a surface in the result folder is one of an earlier run
_STAGES_BEFORE = ("", "capture")
# how often a file was opened or something was undone, which may change the shown surface
_changes: list[int] = [0]


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


NAME = "RobIR growing"  # name of the object and of its mesh; Blender may have to number them
_GROWING = "robir_growing"  # custom property of both
_MOST_BYTES = 1 << 20  # largest file that is read; the engine's have a tenth of it
_DAMAGE = (
    OSError, ValueError, KeyError, EOFError, RuntimeError, MemoryError, zipfile.BadZipFile,
)  # fmt: skip

# vertices (V, 3) float32 in the capture's frame and unit, triangles (F, 3) int32
Surface = tuple[np.ndarray, np.ndarray]


def read_surface(file: Path) -> Surface | None:
    """The surface that the engine wrote last; None where the file is missing or not whole."""
    try:
        with zipfile.ZipFile(io.BytesIO(read_regular(file, _MOST_BYTES))) as archive:
            vertices = _array(archive, "vertices.npy", np.float32)
            faces = _array(archive, "faces.npy", np.int32)
    except _DAMAGE:
        return None
    if not len(faces) or not len(vertices) or not np.isfinite(vertices).all():
        return None
    if faces.min() < 0 or faces.max() >= len(vertices):
        return None
    return vertices, faces


def show_surface(scene: bpy.types.Scene, surface: Surface) -> None:
    """Show a surface instead of the one before, placed as the capture is, if there is one."""
    collection = next((c for c in scene.collection.children_recursive if MARK in c), None)
    if collection is None:
        return
    vertices, faces = surface
    settings = scene.robir
    placed = settings.view_scale * vertices.astype(np.float64) + np.array(settings.view_shift)
    if np.abs(placed).max() > np.finfo(np.float32).max:
        return
    shown = next((o for o in collection.objects if _GROWING in o and o.type == "MESH"), None)
    if shown is None:
        clear_surface()
        shown = bpy.data.objects.new(NAME, bpy.data.meshes.new(NAME))
        for block in (shown, shown.data):  # the capture's mark too: it goes when that is put away
            block[_GROWING] = block[MARK] = True
        shown.hide_select = shown.hide_render = True
        collection.objects.link(shown)
    mesh = shown.data
    if mesh.is_editmode:
        return
    mesh.clear_geometry()
    mesh.from_pydata(placed.tolist(), [], faces.tolist())
    mesh.validate()  # triangles that are lines or that stand there twice
    mesh.polygons.foreach_set("use_smooth", np.ones(len(mesh.polygons), dtype=bool))
    mesh.update()


def clear_surface() -> None:
    """Take the surface away, in all scenes."""
    for blocks in (bpy.data.objects, bpy.data.meshes):
        for block in [b for b in blocks if _GROWING in b and b.library is None]:
            blocks.remove(block)


def _array(archive: zipfile.ZipFile, name: str, kind: type) -> np.ndarray:
    """An array (N, 3) of a file that numpy wrote uncompressed, so that nothing can swell."""
    if archive.getinfo(name).compress_type != zipfile.ZIP_STORED:
        raise ValueError("it is compressed")
    array = np.lib.format.read_array(io.BytesIO(archive.read(name)), allow_pickle=False)
    if array.dtype != kind or array.shape[1:] != (3,):
        raise ValueError("it holds something else")
    return array
