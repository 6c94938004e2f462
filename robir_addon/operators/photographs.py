# SPDX-License-Identifier: GPL-3.0-or-later
"""Photographs that a finding names are left out, and the capture is looked at without them."""

import bpy
from bpy.props import IntProperty

from ..words import reported, told
from .capture import has_capture, may_begin

MISSING = "missing-images"
"""Code of the finding that poses have no photograph."""


class ROBIR_OT_leave_out(bpy.types.Operator):
    """Do without the photographs of a finding."""

    bl_idname = "robir.leave_out"
    bl_label = "Leave Out"
    bl_description = (
        "Do without the photographs that this finding names, and look at the capture again; "
        "the list of photographs takes them back"
    )
    bl_options = {"REGISTER", "UNDO"}

    finding: IntProperty(
        name="Finding", description="Its place in the list of findings", options={"SKIP_SAVE"}
    )

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Once a capture was looked at, while nothing is at work."""
        if not (has_capture(cls, context) and may_begin(cls, context)):
            return False
        if not context.window_manager.robir.findings:
            cls.poll_message_set(told("Look at the capture first"))
            return False
        return True

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Look again without making the user wait."""
        return self._leave_out(context, "INVOKE_DEFAULT")

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Look again and return when that is done."""
        return self._leave_out(context, "EXEC_DEFAULT")

    def _leave_out(self, context: bpy.types.Context, way: str) -> set[str]:
        settings = context.scene.robir
        findings = context.window_manager.robir.findings
        finding = findings[min(self.finding, len(findings) - 1)]
        if finding.code == MISSING:
            settings.skip_missing = True
        for name in finding.files.splitlines():
            photograph = settings.photographs.get(name)
            if photograph is not None:
                photograph.is_used = False
        try:
            return bpy.ops.robir.look_at_capture(way)
        except RuntimeError as fault:  # how Blender passes on what that operator reported
            self.report({"ERROR"}, reported(fault))
            return {"CANCELLED"}


def can_leave_out(finding: bpy.types.AnyType, settings: bpy.types.AnyType) -> bool:
    """Whether a finding names photographs that the capture may do without."""
    names = finding.files.splitlines()
    known = settings.photographs
    return finding.code == MISSING or any(n in known and known[n].is_used for n in names)


CLASSES = (ROBIR_OT_leave_out,)
