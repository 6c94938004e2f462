# SPDX-License-Identifier: GPL-3.0-or-later
"""Named sets of what the panel Reconstruct asks for, kept by Blender among the user's presets."""

import bpy
from bl_operators.presets import AddPresetBase


class ROBIR_MT_presets(bpy.types.Menu):
    """The presets by name."""

    bl_label = "Reconstruction Presets"
    preset_subdir = "robir/reconstruct"
    preset_operator = "script.execute_preset"
    draw = bpy.types.Menu.draw_preset


class ROBIR_OT_add_preset(AddPresetBase, bpy.types.Operator):
    """Keep or drop a set of choices."""

    bl_idname = "robir.add_preset"
    bl_label = "Add Reconstruction Preset"
    bl_description = "Keep the choices of the panel Reconstruct under a name, or remove a preset"
    preset_menu = "ROBIR_MT_presets"
    preset_subdir = ROBIR_MT_presets.preset_subdir
    preset_defines = ("settings = bpy.context.scene.robir",)
    preset_values = ("settings.preset", "settings.device", "settings.use_sun_lamp")


CLASSES = (ROBIR_MT_presets, ROBIR_OT_add_preset)
