# SPDX-License-Identifier: GPL-3.0-or-later
"""What panels draw alike: sentences in lines that fit, for labels cut them off; rows and bars."""

from functools import lru_cache

import blf
import bpy

from .child import ADDON
from .words import duration, words

_MARGIN = 60  # points of the region that hold its tabs, the panel's border and a label's padding
_ICON = 22  # points that an icon takes from a line
_BOX = 16  # points that the borders of a box take
_WIDTH_WITHOUT_REGION = 300


def paragraph(
    layout: bpy.types.UILayout,
    context: bpy.types.Context,
    text: str,
    icon: str = "NONE",
    *,
    is_boxed: bool = False,
) -> bpy.types.UILayout:
    """Draw a sentence as labels, one a line, the icon before the first; their column."""
    system = context.preferences.system
    scale = system.ui_scale or 1.0  # zero without a window
    points = context.preferences.ui_styles[0].widget.points
    region = context.region
    width = region.width / scale if region and region.width > 1 else _WIDTH_WITHOUT_REGION
    room = width - _MARGIN - (_ICON if icon != "NONE" else 0) - (_BOX if is_boxed else 0)
    column = layout.column(align=True)
    column.scale_y = 0.8
    for number, line in enumerate(break_lines(text, int(max(room, 40.0)), points)):
        if icon == "NONE":
            column.label(text=line, translate=False)
        else:
            column.label(text=line, icon="BLANK1" if number else icon, translate=False)
    return column


def advice(
    layout: bpy.types.UILayout, context: bpy.types.Context, text: str, cure: str, icon: str
) -> None:
    """Draw what is the matter, and below it what to do about it."""
    paragraph(layout, context, text, icon, is_boxed=True)
    if cure:
        cure = f"{cure[:1].upper()}{cure[1:]}"
        paragraph(layout, context, cure, "BLANK1", is_boxed=True)


@lru_cache(maxsize=512)
def break_lines(text: str, room: int, points: float) -> tuple[str, ...]:
    """Lines of a text no wider than `room`, points; a wider word, as a path, is broken within."""
    blf.size(0, points)
    lines = []
    for given in text.splitlines():
        line = ""
        for word in given.split():
            longer = f"{line} {word}" if line else word
            if blf.dimensions(0, longer)[0] <= room:
                line = longer
                continue
            if line:
                lines.append(line)
            *whole, line = _pieces(word, room)
            lines += whole
        lines.append(line)
    return tuple(lines)


def _pieces(word: str, room: int) -> list[str]:
    """A word cut into pieces that fit, each at least one letter long."""
    pieces = [""]
    for letter in word:
        if pieces[-1] and blf.dimensions(0, pieces[-1] + letter)[0] > room:
            pieces.append("")
        pieces[-1] += letter
    return pieces


class Panel:
    """Where all panels are: the sidebar's tab."""

    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "RobIR"


class ResultPanel(Panel):
    """Drawn once there is a result."""

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Whether there is one."""
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
    layout.operator("robir.cancel_reconstruct", icon="CANCEL")
