# SPDX-License-Identifier: GPL-3.0-or-later
"""A result arrives: it is imported, becomes the shown one, and is seen in its own light."""

from pathlib import Path

import bpy
import numpy as np
from mathutils import Vector

from ..blocks import MARK, select_alone
from ..capture.framing import frame
from ..capture.startup import put_aside
from ..gateway import JobPaths
from ..relighting.lights import turn_light
from ..relighting.view_transform import view_name, view_transform_differs
from ..words import told
from .importer import asset_of, import_result, read_tone_curve


def bring_in(context: bpy.types.Context, root: Path) -> list[str]:
    """Import a result and show it; a new one is selected and framed. What to tell the user."""
    scene = context.scene
    settings = scene.robir
    curve = read_tone_curve(JobPaths(root))
    is_new = asset_of(root) is None
    imported = import_result(root, scene, use_sun_lamp=settings.use_sun_lamp)
    settings.result = str(root)
    if not is_new:
        turn_light(scene, settings.rotation)
        text = "{name} is as the newer result has it; what you did is kept"
        return [told(text, name=imported.asset.name)]
    settings.rotation = 0.0
    context.view_layer.update()  # else Blender 5 lists objects that are gone
    select_alone(context.view_layer, imported.asset)
    hidden = put_aside(scene, context.view_layer)
    corners = [imported.asset.matrix_world @ Vector(c) for c in imported.asset.bound_box]
    centre = Vector(np.mean(corners, axis=0))
    frame(scene, centre, max((corner - centre).length for corner in corners))
    light_up(context)
    name, count = imported.asset.name, len(imported.cameras)
    notes = [told("Imported {name} with {count} cameras", name=name, count=count)]
    if view_transform_differs(scene, curve):
        notes.append(
            told(
                "The photographs were made through {made}, the scene is shown through {shown}; "
                "Match View Transform makes them alike",
                made=view_name(curve),
                shown=scene.view_settings.view_transform,
            )
        )
    if hidden:
        notes.append(told("Blender's own objects are hidden: {names}", names=", ".join(hidden)))
    others = [
        o.name for o in scene.objects if o.type == "LIGHT" and MARK not in o and not o.hide_render
    ]
    if others:
        text = "The scene's own lights shine on the object too: {names}"
        notes.append(told(text, names=", ".join(others)))
    return notes


def light_up(context: bpy.types.Context) -> None:
    """Show the viewports of the scene lit by what the scene holds."""
    for window in context.window_manager.windows:
        if window.scene != context.scene:
            continue
        for area in window.screen.areas:
            if area.type != "VIEW_3D":
                continue
            shading = area.spaces.active.shading
            if shading.type in ("WIREFRAME", "SOLID"):  # these show neither material nor light
                shading.type = "MATERIAL"
            shading.use_scene_world = shading.use_scene_lights = True
