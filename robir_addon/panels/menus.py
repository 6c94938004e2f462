# SPDX-License-Identifier: GPL-3.0-or-later
"""All commands as menu entries, where the search (F3) looks; the panel What You Know."""

import math
from pathlib import Path

import bpy
from bpy.props import CollectionProperty, StringProperty

from ..operators.capture import take_capture
from ..operators.shared import WaitingOperator, may_choose, result_root
from ..paragraphs import Panel, paragraph, split
from ..result.delight import target_of
from ..result.summary import shown_summary
from ..words import told, words

_IN_ORDER = (
    ("choose_capture", "try_sample", "look_at_capture", "leave_out", "add_box", "clear_capture"),
    ("reconstruct", "reconstruct_sample", "delight", "cancel_reconstruct"),
    ("run_batch", "stop_batch", "add_library"),
    ("import_result", "refresh_result", "remove_result"),
    ("pick_spot", "forget_spot", "take_sun", "forget_sun"),
    ("set_real_size", "stand_on_floor", "drop_ground", "crop_to_box"),
    ("compare", "compare_next", "show_few_views", "match_view_transform"),
    ("use_environment", "picture_lights", "into_photograph", "turntable"),
    ("export_game", "export_glb", "export_usd", "export_textures", "mark_asset"),
    ("install_engine", "check_engine", "remove_engine"),
    ("open_report", "copy_report", "dismiss", "allow_online"),
)


class ROBIR_MT_commands(bpy.types.Menu):
    """All commands in order of work."""

    bl_label = "RobIR"

    def draw(self, context: bpy.types.Context) -> None:
        layout, settings = self.layout, context.scene.robir
        for group in _IN_ORDER:
            for name in group:
                layout.operator(f"robir.{name}")
            if "reconstruct" in group:
                layout.prop_menu_enum(settings, "texture")
                layout.prop_menu_enum(settings, "device")
            if "pick_spot" in group:
                layout.prop_menu_enum(settings, "tone_curve")
            if "use_environment" in group:
                layout.prop_menu_enum(settings, "light")
                layout.prop(settings, "use_sun_lamp")
            layout.separator()


def _draw_in_view(menu: bpy.types.Menu, context: bpy.types.Context) -> None:
    menu.layout.separator()
    menu.layout.menu(ROBIR_MT_commands.__name__)


def _draw_in_import(menu: bpy.types.Menu, context: bpy.types.Context) -> None:
    menu.layout.operator("robir.choose_capture", text="RobIR Capture (folder)")
    menu.layout.operator("robir.import_result", text="RobIR Result (folder)")


def register() -> None:
    """Add the menu to the 3D viewport's View, and the folders to File > Import."""
    bpy.types.VIEW3D_MT_view.append(_draw_in_view)
    bpy.types.TOPBAR_MT_file_import.append(_draw_in_import)


def unregister() -> None:
    """Take the entries back."""
    bpy.types.TOPBAR_MT_file_import.remove(_draw_in_import)
    bpy.types.VIEW3D_MT_view.remove(_draw_in_view)


class ROBIR_PT_known(Panel, bpy.types.Panel):
    """What is known of the capture beside its photographs."""

    bl_label = "What You Know"
    bl_parent_id = "ROBIR_PT_capture"
    bl_options = {"DEFAULT_CLOSED"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return bool(context.scene.robir.capture)

    def draw(self, context: bpy.types.Context) -> None:
        layout, settings = self.layout, context.scene.robir
        summary = shown_summary(settings)
        if summary is not None and summary.brightness:
            paragraph(layout, context, summary.brightness)
        row = layout.row(align=True)
        row.operator("robir.pick_spot", icon="CURSOR")
        if settings.spot_result:
            row.operator("robir.forget_spot", text="", icon="X")
            text = "The colour of the dot on the object is known"
            paragraph(layout, context, words(text), "CHECKMARK")
            split(layout).prop(settings, "spot_albedo")
        row = layout.row(align=True)
        row.operator("robir.take_sun", icon="LIGHT_SUN")
        if any(settings.sun):
            row.operator("robir.forget_sun", text="", icon="X")
            height = math.degrees(math.asin(max(-1.0, min(1.0, settings.sun[2]))))
            text = "The sun stood {height:.0f}\N{DEGREE SIGN} high"
            paragraph(layout, context, words(text, height=height), "CHECKMARK")
        split(layout).prop(settings, "tone_curve")
        if settings.result:
            text = "Only light and materials are found again; the shape stays"
            paragraph(layout, context, words(text)).active = False
            is_own = target_of(result_root(context)) is not None
            name = "robir.delight" if is_own else "robir.reconstruct"
            layout.operator(name, text="Find Light Again", icon="FILE_REFRESH")


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
