# SPDX-License-Identifier: GPL-3.0-or-later
"""Sentences in a panel, broken into lines that fit it; Blender's labels would cut them off."""

from functools import lru_cache

import blf
import bpy

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


@lru_cache(maxsize=512)
def break_lines(text: str, room: int, points: float) -> tuple[str, ...]:
    """Lines of a text no wider than `room`, points; a wider word, as a path, is broken within."""
    blf.size(0, points)
    lines = []
    for given in text.splitlines():
        line = ""
        for word in given.split():
            longer = f"{line} {word}" if line else word
            if _width(longer) <= room:
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
        if pieces[-1] and _width(pieces[-1] + letter) > room:
            pieces.append("")
        pieces[-1] += letter
    return pieces


def _width(text: str) -> float:
    return blf.dimensions(0, text)[0]
