# SPDX-License-Identifier: GPL-3.0-or-later
"""Parts that several panels draw alike."""

import bpy

from ..child import ADDON
from ..paragraphs import paragraph
from ..words import duration, words


class Panel:
    """Where all panels are: the sidebar's tab."""

    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "RobIR"


class ResultPanel(Panel):
    """Drawn once there is a result."""

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return bool(context.scene.robir.result)


def preferences_button(layout: bpy.types.UILayout, text: str) -> None:
    """The button that leads to the choice of the engine."""
    button = layout.operator("preferences.addon_show", text=text, icon="PREFERENCES")
    button.module = ADDON


def big(layout: bpy.types.UILayout) -> bpy.types.UILayout:
    """A row for the button that matters."""
    row = layout.row()
    row.scale_y = 1.5
    return row


def split(layout: bpy.types.UILayout) -> bpy.types.UILayout:
    """A column of properties with their names at the left."""
    column = layout.column()
    column.use_property_split = True
    column.use_property_decorate = False
    return column


def progress(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    """How far the work is, what is being done, and the button that stops it."""
    state = context.window_manager.robir
    text = f"{100.0 * state.fraction:.0f} %"
    if state.seconds_left >= 0.0:
        left = duration(state.seconds_left)
        text = words("{share}, {duration} left", share=text, duration=left)
    layout.progress(factor=state.fraction, type="BAR", text=text)
    if state.message:
        paragraph(layout, context, state.message)
    stop = "robir.cancel_install" if state.task == "install" else "robir.cancel_reconstruct"
    layout.operator(stop, text="Cancel", icon="CANCEL")
