# SPDX-License-Identifier: Apache-2.0
"""Whether a thing is seen in the viewport."""

from __future__ import annotations

from window.blender_window import BlenderWindow

# where a thing lies in the viewport, and where the sidebar begins
IN_VIEW = """
from bpy_extras.view3d_utils import location_3d_to_region_2d as project
from mathutils import Vector
area = next(a for a in window.screen.areas if a.type == "VIEW_3D")
whole = next(r for r in area.regions if r.type == "WINDOW")
side = next(r for r in area.regions if r.type == "UI")
thing = {thing}
if thing.type == "EMPTY":
    reach = thing.empty_display_size
    corners = [Vector((x, y, z)) * reach * 0.57 for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]
else:
    corners = [Vector(corner) for corner in thing.bound_box]
seen = [project(whole, area.spaces.active.region_3d, thing.matrix_world @ c) for c in corners]
answer = [min(p.x for p in seen), max(p.x for p in seen), side.x - whole.x,
          min(p.y for p in seen), max(p.y for p in seen), whole.height]
"""


def check_in_view(window: BlenderWindow, thing: str) -> None:
    """A thing is seen whole, and not under the sidebar."""
    left, right, sidebar, low, high, height = window.run(IN_VIEW.format(thing=thing))
    assert 0 < left < right < sidebar
    assert 0 < low < high < height
