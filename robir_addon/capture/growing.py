# SPDX-License-Identifier: GPL-3.0-or-later
"""The surface of a reconstruction that is at work, where the capture's bounds are shown.

The engine replaces its file while Blender reads it, and a result folder may come from anybody: what
is not whole is not shown.
"""

import io
import re
import struct
import zipfile
from pathlib import Path

import bpy
import numpy as np

from ..gateway import read_regular
from .viewport import MARK

NAME = "RobIR growing"  # name of the object and of its mesh; Blender may have to number them
_GROWING = "robir_growing"  # custom property of both
_MOST_BYTES = 1 << 20  # largest file that is read; the engine's have a tenth of it
_HEAD = struct.Struct("<8sH")
_MAGIC = b"\x93NUMPY\x01\x00"
_SHAPE = re.compile(
    rb"\{'descr': '(<f4|<i4)', 'fortran_order': False, 'shape': \((\d{1,7}), 3\), \}\s*"
)
"""What numpy writes before the numbers, where they are what is wanted."""

_DAMAGE = (
    OSError, ValueError, KeyError, EOFError, RuntimeError, NotImplementedError, struct.error,
    zipfile.BadZipFile,
)  # fmt: skip

Surface = tuple[np.ndarray, np.ndarray]
"""Vertices (V, 3) float32 in the capture's frame and unit, triangles (F, 3) int32."""


def read_surface(file: Path) -> Surface | None:
    """The surface that the engine wrote last; None where the file is missing or not whole."""
    try:
        with zipfile.ZipFile(io.BytesIO(read_regular(file, _MOST_BYTES))) as archive:
            vertices = _array(archive, "vertices.npy", b"<f4")
            faces = _array(archive, "faces.npy", b"<i4")
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
        shown = _new_object(collection)
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


def _new_object(collection: bpy.types.Collection) -> bpy.types.Object:
    mesh = bpy.data.meshes.new(NAME)
    shown = bpy.data.objects.new(NAME, mesh)
    for block in (shown, mesh):  # the capture's mark too: it goes when that is put away
        block[_GROWING] = block[MARK] = True
    shown.hide_select = shown.hide_render = True
    collection.objects.link(shown)
    return shown


def _array(archive: zipfile.ZipFile, name: str, kind: bytes) -> np.ndarray:
    """An array (N, 3) of a file that numpy wrote uncompressed, so that nothing can swell."""
    if archive.getinfo(name).compress_type != zipfile.ZIP_STORED:
        raise ValueError("it is compressed")
    content = archive.read(name)
    magic, size = _HEAD.unpack_from(content)
    head = _SHAPE.fullmatch(content[_HEAD.size : _HEAD.size + size])
    if magic != _MAGIC or head is None or head[1] != kind:
        raise ValueError("it holds something else")
    numbers = np.frombuffer(content, np.dtype(kind.decode()), offset=_HEAD.size + size)
    return numbers.reshape(int(head[2]), 3)
