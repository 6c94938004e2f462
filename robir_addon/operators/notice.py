# SPDX-License-Identifier: GPL-3.0-or-later
"""What a notice offers: to be put away, and the permission that it asks for."""

import bpy

from ..words import told
from ..work import monitor
from .engine import OFFLINE
from .shared import Operator, WaitingOperator


def _has_notice(context: bpy.types.Context) -> str:
    state = context.window_manager.robir
    return "" if state.error or (state.message and not state.task) else told("There is no notice")


def _is_undecided(context: bpy.types.Context) -> str:
    is_decided = bpy.app.online_access_override or context.preferences.system.use_online_access
    return told("Online access is decided already") if is_decided else ""


class ROBIR_OT_dismiss(Operator, bpy.types.Operator):
    """Put this notice away; nothing else changes."""

    bl_label = "Dismiss"
    bl_options = {"REGISTER"}
    needs = (_has_notice,)

    def work(self, context: bpy.types.Context) -> None:
        """What was said is forgotten wherever an operator begins."""


class ROBIR_OT_allow_online(WaitingOperator, bpy.types.Operator):
    """Turn on Allow Online Access in Blender's preferences, which holds for all extensions, and
    install the engine.
    """

    bl_label = "Allow Online Access and Install"
    bl_options = {"REGISTER"}
    needs = (_is_undecided,)

    def begin(self, context: bpy.types.Context, way: str) -> set[str]:
        context.preferences.system.use_online_access = True
        monitor.show_problem("")
        # a script installs by itself
        return bpy.ops.robir.install_engine(way) if way == "INVOKE_DEFAULT" else {"FINISHED"}


def is_offline(state: bpy.types.AnyType) -> bool:
    """Whether the notice is that the permission to go online is missing."""
    return state.error == told(OFFLINE)
