# SPDX-License-Identifier: GPL-3.0-or-later
"""What photographs leave open and the user may settle: a paint, the sun, the tone curve."""

import math

import bpy

from ..operators.shared import result_root
from ..paragraphs import paragraph
from ..result.delight import target_of
from ..result.summary import shown_summary
from ..words import words
from .drawing import Panel, split


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
