# SPDX-License-Identifier: GPL-3.0-or-later
"""What the pictures of a comparison are, written over them in the Image Editor; not into them."""

from typing import Any

import blf
import bpy

CAPTIONS = "robir_captions"
"""Custom property of an image: its title and the names of its pictures from left to right, one a
line."""

_SIZE = 13.0
_GAP = 8.0

_handles: list[Any] = []


def _draw() -> None:
    context = bpy.context
    image = context.space_data.image
    if image is None or CAPTIONS not in image:
        return
    title, *names = image[CAPTIONS].splitlines()
    scale = context.preferences.system.ui_scale
    to_region = context.region.view2d.view_to_region
    blf.size(0, _SIZE * scale)
    blf.color(0, *context.preferences.themes[0].image_editor.space.text_hi, 1.0)
    for place, name in enumerate(names):
        x, y = to_region((place + 0.5) / len(names), 0.0, clip=False)
        _write(name, x, y - (_GAP + _SIZE) * scale)
    x, y = to_region(0.5, 1.0, clip=False)
    _write(title, x, y + _GAP * scale)


def _write(text: str, middle: float, bottom: float) -> None:
    blf.position(0, middle - 0.5 * blf.dimensions(0, text)[0], bottom, 0.0)
    blf.draw(0, text)


def register() -> None:
    """Draw over Image Editors; without a window there is nothing to draw on."""
    if not bpy.app.background:
        space = bpy.types.SpaceImageEditor
        _handles.append(space.draw_handler_add(_draw, (), "WINDOW", "POST_PIXEL"))


def unregister() -> None:
    """Draw no more."""
    while _handles:
        bpy.types.SpaceImageEditor.draw_handler_remove(_handles.pop(), "WINDOW")
