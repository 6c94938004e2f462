# SPDX-License-Identifier: GPL-3.0-or-later
"""All commands as menu entries, where the search (F3) looks; the panel What You Know."""

import math

import bpy

from ..operators.shared import result_root
from ..paragraphs import Panel, paragraph, split
from ..result.delight import target_of
from ..result.summary import shown_summary
from ..words import words

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
    ("install_engine", "cancel_install", "check_engine", "remove_engine"),
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
                layout.prop_menu_enum(settings, "preset")
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
            u, v = settings.spot_texel
            text = "Known paint at {u:.3f}, {v:.3f} of the texture"
            paragraph(layout, context, words(text, u=u, v=v), "CHECKMARK")
            split(layout).prop(settings, "spot_albedo")
        row = layout.row(align=True)
        row.operator("robir.take_sun", icon="LIGHT_SUN")
        if any(settings.sun):
            row.operator("robir.forget_sun", text="", icon="X")
            height = math.degrees(math.asin(max(-1.0, min(1.0, settings.sun[2]))))
            text = "Known sun {height:.0f}\N{DEGREE SIGN} high"
            paragraph(layout, context, words(text, height=height), "CHECKMARK")
        split(layout).prop(settings, "tone_curve")
        if settings.result:
            text = "Only light and materials are found again; the shape stays"
            paragraph(layout, context, words(text)).active = False
            is_own = target_of(result_root(context)) is not None
            name = "robir.delight" if is_own else "robir.reconstruct"
            layout.operator(name, text="Find Light Again", icon="FILE_REFRESH")
