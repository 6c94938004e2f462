# SPDX-License-Identifier: GPL-3.0-or-later
"""The imported object as an asset of Blender's library, complete without its result folder."""

import ctypes
import os
import uuid

import bpy
import numpy as np

from ..blocks import MARK
from ..gateway import JobPaths, __version__
from .importer import read_cameras, read_run
from .pictures import compare, one_of

# where Blender's AssetMetaData holds the catalogue's number; its short name follows
_CATALOGUE_AT = 2 * ctypes.sizeof(ctypes.c_void_p)
_MOST_SIDE = 256  # of the preview, pixels
_SIMPLE_NAME = "Reconstructed by RobIR"
_SIMPLE_NAME_BYTES = 64


def make_asset(asset: bpy.types.Object, paths: JobPaths, *, is_packed: bool = True) -> None:
    """Mark an object as an asset, with what is known of it and a picture; saves nothing."""
    run = read_run(paths)
    table = read_cameras(paths)
    picture = one_of(compare(paths)[1], 1)
    step = -(-len(picture) // _MOST_SIDE)
    picture = picture[::step, ::step]
    asset.asset_mark()
    data = asset.asset_data
    data.description = (
        f"Reconstructed from {len(table['views'])} photographs by RobIR {__version__}"
    )
    for tag in ("RobIR", "reconstruction", paths.root.name):
        data.tags.new(tag, skip_if_exists=True)
    asset["robir_version"] = __version__
    for name in ("device", "seed"):
        asset[f"robir_{name}"] = run[name]
    for slot in asset.material_slots:
        for node in slot.material.node_tree.nodes if slot.material else ():
            if node.type == "TEX_IMAGE" and node.image and not node.image.packed_file and is_packed:
                node.image.pack()
    preview = asset.preview_ensure()
    preview.image_size = picture.shape[1::-1]
    preview.image_pixels_float.foreach_set(picture.astype(np.float32).ravel())


def fill_simple_name(data: bpy.types.AssetMetaData) -> None:
    """Fill a field that Blender else leaves as its memory was, and writes to the file as that.

    The file would hold 63 bytes of the process, of its variables for instance. Python may not
    write the field, and zeros would not be copied: so it is filled to its end. Where the memory is
    laid out otherwise than expected, it is left alone.
    """
    catalogue, mark = data.catalog_id, uuid.uuid5(uuid.NAMESPACE_OID, "RobIR")
    data.catalog_id = str(mark)
    start = data.as_pointer() + _CATALOGUE_AT
    if ctypes.string_at(start, len(mark.bytes_le)) == mark.bytes_le:
        name = _SIMPLE_NAME.ljust(_SIMPLE_NAME_BYTES - 1).encode("ascii") + b"\0"
        ctypes.memmove(start + len(mark.bytes_le), name, len(name))
        ctypes.memmove(start, uuid.UUID(catalogue).bytes_le, len(mark.bytes_le))
    else:
        data.catalog_id = catalogue


def leave_machine(paths: JobPaths, mark: str | None) -> None:
    """Take out what names folders of this machine and so its user; marks become `mark`."""
    for block in bpy.data.user_map():
        if MARK in block and mark is None:
            del block[MARK]
        elif MARK in block:
            block[MARK] = mark
    for image in bpy.data.images:
        for file in image.packed_files:
            file.filepath = f"//{os.path.relpath(file.filepath, paths.export)}"
