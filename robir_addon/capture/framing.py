# SPDX-License-Identifier: GPL-3.0-or-later
"""The viewport's look at something: in the middle of what the sidebar leaves free, and near enough.

Blender's own View Selected takes the viewport as a whole, half of which may lie under the sidebar.
"""

from collections.abc import Sequence

import bpy
from mathutils import Vector

_ROOM = 1.15  # how much farther off the view is than it need be


def frame(scene: bpy.types.Scene, centre: Sequence[float], radius: float) -> None:
    """Make the viewports of a scene look at a sphere, world."""
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas if window.scene == scene else ():
            if area.type == "VIEW_3D":
                _frame_area(area, Vector(centre), radius)


def _frame_area(area: bpy.types.Area, centre: Vector, radius: float) -> None:
    space = area.spaces.active
    view = space.region_3d
    if view.view_perspective == "CAMERA":
        view.view_perspective = "PERSP"
    width, height, left, right = _free_room(area)
    # Blender's viewport shows 72 mm along its longer side
    longer = max(width, height)
    half = 36.0 / space.lens * width / longer, 36.0 / space.lens * height / longer
    share = max(0.2, (width - left - right) / width)
    distance = _ROOM * radius * (1.0 + 1.0 / min(share * half[0], half[1]) ** 2) ** 0.5
    aside = Vector(((right - left) / width * half[0] * distance, 0.0, 0.0))
    view.view_location = centre + view.view_rotation @ aside
    view.view_distance = distance
    space.clip_start = min(space.clip_start, 1e-3 * radius)
    space.clip_end = max(space.clip_end, 20.0 * distance)


def _free_room(area: bpy.types.Area) -> tuple[int, int, int, int]:
    """Width and height of the viewport, and how much lies under tools and sidebar."""
    whole = next(region for region in area.regions if region.type == "WINDOW")
    under = {"TOOLS": 0, "UI": 0}
    for region in area.regions:
        if region.type in under and region.width > 1 and region.x < whole.x + whole.width:
            under[region.type] = region.width if region.x >= whole.x else 0
    return whole.width, whole.height, under["TOOLS"], under["UI"]
