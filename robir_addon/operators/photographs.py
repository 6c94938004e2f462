# SPDX-License-Identifier: GPL-3.0-or-later
"""Photographs that a finding names are left out, and the capture is looked at without them."""

import bpy
from bpy.props import IntProperty

from ..words import told
from .shared import WaitingOperator, at_rest, has_capture

MISSING = "missing-images"  # code of the finding that poses have no photograph


def _has_findings(context: bpy.types.Context) -> str:
    return "" if context.window_manager.robir.findings else told("Look at the capture first")


class ROBIR_OT_leave_out(WaitingOperator, bpy.types.Operator):
    """Do without the photographs that this finding names, and look at the capture again; the list
    of photographs takes them back.
    """

    bl_label = "Leave Out"
    needs = (has_capture, at_rest, _has_findings)

    finding: IntProperty(
        name="Finding", description="Its place in the list of findings", options={"SKIP_SAVE"}
    )

    def begin(self, context: bpy.types.Context, way: str) -> set[str]:
        settings = context.scene.robir
        findings = context.window_manager.robir.findings
        finding = findings[min(self.finding, len(findings) - 1)]
        if finding.code == MISSING:
            settings.skip_missing = True
        for name in finding.files.splitlines():
            photograph = settings.photographs.get(name)
            if photograph is not None:
                photograph.is_used = False
        return bpy.ops.robir.look_at_capture(way)


def can_leave_out(finding: bpy.types.AnyType, settings: bpy.types.AnyType) -> bool:
    """Whether a finding names photographs that the capture may do without."""
    names = finding.files.splitlines()
    known = settings.photographs
    return finding.code == MISSING or any(n in known and known[n].is_used for n in names)
