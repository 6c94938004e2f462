# SPDX-License-Identifier: GPL-3.0-or-later
"""The object in its photograph: a ground that catches its shadow, and the photograph behind."""

from collections.abc import Mapping
from typing import Any

import bpy
from mathutils import Vector

from ..blocks import MARK, with_mark
from ..capture.cameras import capture_cameras, use_camera
from .placing import middle_of_foot

_GROUND = "robir_shadow_ground"
"""Custom property of the ground: whether the film was transparent before."""

_REACH = 20.0  # side of the ground, longest sides of the object


def set_stage(
    context: bpy.types.Context, asset: bpy.types.Object, ground: Mapping[str, Any] | None
) -> None:
    """Lay a ground of the capture's frame, and look through a camera of the photographs."""
    scene = context.scene
    own = [c for c in capture_cameras(scene) if c[MARK] == asset[MARK]]
    camera = next((c for c in (context.object, scene.camera) if c in own), own[0] if own else None)
    data, half = bpy.data.meshes.new("RobIR ground"), 0.5 * _REACH * max(asset.dimensions)
    corners = [(-half, -half, 0), (half, -half, 0), (half, half, 0), (-half, half, 0)]
    data.from_pydata(corners, [], [(0, 1, 2, 3)])
    floor = bpy.data.objects.new(data.name, data)
    middle = asset.matrix_world @ (sum((Vector(c) for c in asset.bound_box), Vector()) / 8)
    floor.location = (middle.x, middle.y, middle_of_foot(asset, ground).z)
    floor.is_shadow_catcher, floor.hide_select = True, True
    floor.display_type = "WIRE"  # only Cycles knows shadow catchers
    floor[_GROUND], data[MARK] = scene.render.film_transparent, asset[MARK]
    scene.collection.objects.link(floor)
    scene.render.film_transparent = True
    scene.render.engine = "CYCLES"
    if camera is None:
        return
    use_camera(scene, camera)
    for photo in camera.data.background_images:
        photo.display_depth = "BACK"
    for window in context.window_manager.windows:
        for area in window.screen.areas if window.scene == scene else ():
            if area.type == "VIEW_3D":
                area.spaces.active.region_3d.view_perspective = "CAMERA"


def clear_stage(scene: bpy.types.Scene, mark: str) -> bool:
    """Take the ground of a result away; whether there was one."""
    found = [data for data in with_mark(bpy.data.meshes, mark) if data.name.startswith("RobIR g")]
    floors = [o for o in scene.objects if _GROUND in o and o.data in found]
    for floor in floors:
        scene.render.film_transparent = bool(floor[_GROUND])
    bpy.data.batch_remove([*floors, *found])
    return bool(floors)
