# SPDX-License-Identifier: GPL-3.0-or-later
"""What a notice offers: to be put away, and the permission that it asks for."""

import bpy

from ..words import reported, told
from ..work import monitor
from .engine import OFFLINE


class ROBIR_OT_dismiss(bpy.types.Operator):
    """Put the notice away."""

    bl_idname = "robir.dismiss"
    bl_label = "Dismiss"
    bl_description = "Put this notice away; nothing else changes"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """While there is one."""
        state = context.window_manager.robir
        if state.error or (state.message and not state.task):
            return True
        cls.poll_message_set(told("There is no notice"))
        return False

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Forget what was said."""
        state = context.window_manager.robir
        monitor.show_problem("")
        if not state.task:
            state.message = ""
        return {"FINISHED"}


class ROBIR_OT_allow_online(bpy.types.Operator):
    """Blender's own permission to go online, and then what it was needed for."""

    bl_idname = "robir.allow_online"
    bl_label = "Allow Online Access and Install"
    bl_description = (
        "Turn on Allow Online Access in Blender's preferences, which holds for all extensions, "
        "and install the engine"
    )

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Where the permission is missing and can be given."""
        if bpy.app.online_access_override or context.preferences.system.use_online_access:
            cls.poll_message_set(told("Online access is decided already"))
            return False
        return True

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Allow, and install while Blender stays usable."""
        self.execute(context)
        try:
            return bpy.ops.robir.install_engine("INVOKE_DEFAULT")
        except RuntimeError as fault:  # how Blender passes on what that operator reported
            self.report({"ERROR"}, reported(fault))
            return {"CANCELLED"}

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Allow; a script installs by itself."""
        context.preferences.system.use_online_access = True
        monitor.show_problem("")
        return {"FINISHED"}


def is_offline(state: bpy.types.AnyType) -> bool:
    """Whether the notice is that the permission to go online is missing."""
    return state.error == told(OFFLINE)


CLASSES = (ROBIR_OT_dismiss, ROBIR_OT_allow_online)
