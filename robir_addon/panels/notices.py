# SPDX-License-Identifier: GPL-3.0-or-later
"""What has to be said before all else: what went wrong, what came of the work, what is missing."""

import bpy

from ..engine import CAN_INSTALL
from ..operators.engine import has_notice, is_offline
from ..paragraphs import Panel, paragraph, preferences_button, progress
from ..preferences import install_text, shown_engine_status
from ..words import told, words


class ROBIR_PT_notice(Panel, bpy.types.Panel):
    """What went wrong last, or what came of the last work, above everything else."""

    bl_label = "Notice"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        state = context.window_manager.robir
        status = shown_engine_status(context)
        is_below = status.state != "ready" and state.error == told(status.text)
        if is_below or (is_offline(state) and bpy.app.online_access):
            return False
        return has_notice(state)

    def draw_header_preset(self, context: bpy.types.Context) -> None:
        self.layout.operator("robir.dismiss", text="", icon="X", emboss=False)

    def draw(self, context: bpy.types.Context) -> None:
        state, layout = context.window_manager.robir, self.layout
        if not state.error:
            paragraph(layout, context, state.message, "INFO")
            return
        # in the theme's own colour of text: its red for alerts cannot be read on every background
        paragraph(layout, context, state.error, "ERROR")
        if state.error_cure:
            paragraph(layout, context, state.error_cure, "BLANK1")
        if is_offline(state):
            layout.operator("robir.allow_online", icon="URL")
        layout.operator("robir.copy_report", icon="COPYDOWN")


class ROBIR_PT_no_engine(Panel, bpy.types.Panel):
    """The way to an engine, above the work that needs one."""

    bl_label = "Engine Needed"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        at_work = context.window_manager.robir.task == "install"
        is_asked = at_work or context.scene.robir.capture or not context.scene.robir.result
        return bool(is_asked) and shown_engine_status(context).state != "ready"

    def draw(self, context: bpy.types.Context) -> None:
        status, box = shown_engine_status(context), self.layout.box()
        if context.window_manager.robir.task == "install":
            box.label(text="Installing the engine", icon="IMPORT")
            progress(box, context)
            return
        cure = told(status.cure)
        paragraph(box, context, told(status.text), "INFO", is_boxed=True)
        paragraph(box, context, f"{cure[:1].upper()}{cure[1:]}", "BLANK1", is_boxed=True)
        row = box.row(align=True)
        if CAN_INSTALL:
            row.operator("robir.install_engine", text=install_text(context), icon="IMPORT")
        preferences_button(row, text="" if CAN_INSTALL else words("Preferences"))
