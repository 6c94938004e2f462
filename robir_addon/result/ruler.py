# SPDX-License-Identifier: GPL-3.0-or-later
"""Points that are being clicked in a viewport, and the line between them."""

import bpy
import gpu
from gpu_extras.batch import batch_for_shader
from mathutils import Vector

_COLOUR = (1.0, 0.55, 0.1, 1.0)


class Ruler:
    """Points, world, drawn in all viewports until removed; a sentence stands in the status bar."""

    def __init__(self, sentence: str) -> None:
        self.points: list[Vector] = []
        space = bpy.types.SpaceView3D
        self._handle = space.draw_handler_add(self._draw, (), "WINDOW", "POST_VIEW")
        self.say(sentence)

    def say(self, sentence: str) -> None:
        """Tell the user what comes next."""
        bpy.context.workspace.status_text_set(sentence)
        _redraw()

    def add(self, point: Vector) -> None:
        """Show one more point."""
        self.points.append(point)
        _redraw()

    def remove(self) -> None:
        """Take it all away."""
        bpy.types.SpaceView3D.draw_handler_remove(self._handle, "WINDOW")
        bpy.context.workspace.status_text_set(None)
        _redraw()

    def _draw(self) -> None:
        shader = gpu.shader.from_builtin("UNIFORM_COLOR")
        gpu.state.depth_test_set("NONE")
        gpu.state.point_size_set(9.0)
        gpu.state.line_width_set(2.0)
        shader.uniform_float("color", _COLOUR)
        for kind in ("POINTS", "LINE_STRIP"):
            batch_for_shader(shader, kind, {"pos": [tuple(p) for p in self.points]}).draw(shader)
        gpu.state.point_size_set(1.0)
        gpu.state.line_width_set(1.0)


def _redraw() -> None:
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            if area.type == "VIEW_3D":
                area.tag_redraw()
