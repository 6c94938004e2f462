# SPDX-License-Identifier: GPL-3.0-or-later
"""A capture dropped on the 3D viewport.

Blender hands over files with known suffixes and no folders, so that any file of the capture that
holds camera poses stands for the folder it belongs to.
"""

from pathlib import Path

import bpy
from bpy.props import CollectionProperty, StringProperty

from ..operators.capture import take_capture
from ..operators.shared import WaitingOperator, may_choose
from ..words import told

SUFFIXES = (".json", ".npz", ".npy", ".bin", ".txt", ".csv", ".xml", ".sfm")
_PHOTOGRAPHS = (
    *(".jpg", ".jpeg", ".png", ".webp", ".tif", ".tiff", ".bmp", ".heic", ".heif", ".exr"),
    *(".dng", ".nef", ".cr2", ".cr3", ".arw", ".raf", ".orf", ".rw2"),
)
_VIDEOS = (".mp4", ".mov", ".mkv", ".avi", ".webm", ".m4v", ".3gp")
_COLMAP = ("cameras", "images", "points3D", "rigs", "frames")


def capture_folder(file: Path) -> Path | None:
    """Capture that a file belongs to: the folder of photographs or poses, or a video itself."""
    folder, suffix, stem = file.parent, file.suffix.lower(), file.stem
    if suffix in (".bin", ".txt") and stem in _COLMAP:
        if folder.parent.name == "sparse":
            folder = folder.parent
        if folder.name == "sparse":
            folder = folder.parent
            return folder.parent if folder.name == "colmap" else folder
        return folder
    known = (
        (suffix == ".json" and stem.startswith("transforms"))
        or (suffix == ".npz" and stem.startswith("cameras"))
        or (suffix == ".npy" and stem == "poses_bounds")
        or suffix in (".csv", ".xml", ".sfm")  # users name these exports as they like
    )
    if suffix in _VIDEOS:
        return file
    return folder if known or suffix in _PHOTOGRAPHS else None


class ROBIR_OT_drop_capture(WaitingOperator, bpy.types.Operator):
    """Take the capture that this file belongs to, show its cameras and check it."""

    bl_label = "Take Capture"
    needs = (may_choose,)

    directory: StringProperty(subtype="DIR_PATH", options={"HIDDEN", "SKIP_SAVE"})
    files: CollectionProperty(
        type=bpy.types.OperatorFileListElement, options={"HIDDEN", "SKIP_SAVE"}
    )

    def begin(self, context: bpy.types.Context, way: str) -> set[str]:
        names = [file.name for file in self.files]
        folders = (capture_folder(Path(self.directory) / name) for name in names)
        folder = next((found for found in folders if found), None)
        if folder is None:
            text = (
                "{name} holds no cameras of a known format; drop transforms.json, cameras.bin, "
                "cameras_sphere.npz, poses_bounds.npy, or the cameras of RealityScan (CSV), "
                "Metashape (XML) or Meshroom (SFM)"
            )
            self.report({"ERROR"}, told(text, name=", ".join(names[:1])))
            return {"CANCELLED"}
        return take_capture(context, folder, way)


class ROBIR_FH_capture(bpy.types.FileHandler):
    """Camera files dropped on the 3D viewport."""

    bl_idname = "ROBIR_FH_capture"
    bl_label = "RobIR capture"
    bl_import_operator = ROBIR_OT_drop_capture.bl_idname
    bl_file_extensions = ";".join((*SUFFIXES, *_PHOTOGRAPHS, *_VIDEOS))

    @classmethod
    def poll_drop(cls, context: bpy.types.Context) -> bool:
        return context.area is not None and context.area.type == "VIEW_3D"
