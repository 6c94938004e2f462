# SPDX-License-Identifier: GPL-3.0-or-later
"""Everything the panels can do as menu entries, which is where Blender's search (F3) looks."""

import bpy

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
