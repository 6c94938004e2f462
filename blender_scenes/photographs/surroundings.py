# SPDX-License-Identifier: GPL-3.0-or-later
"""What is round the thing: a table, a room with a window or a lamp, or a map with a sun."""

from pathlib import Path

import bpy
import numpy as np
from mathutils import Matrix

from blender_scenes import lights
from blender_scenes.format import write_environment
from blender_scenes.objects import Pose, add_object
from blender_scenes.photographs.finishes import material
from blender_scenes.photographs.recipe import Light, PhotoRecipe, Table
from blender_scenes.recipe import Cameras, Recipe, Rgb, Sky, Sun
from blender_scenes.request import SceneRequest
from blender_scenes.shapes import Shape, box, cylinder, sphere

THICKNESS = 0.06
"""Of the table's top, scene units: a thing of 20 cm stands on one of 12 mm."""

FLOOR = -2.6
"""Height of the room's floor, and of the table's foot."""

CEILING = 4.6
"""Height of the ceiling at least."""

HALF_ROOM = 4.5
"""From the middle to a wall at least."""

BAR = 0.1
"""Width of a window's bars."""

PANES = (2, 3)
"""Of a window: beside and above each other."""

WINDOW_SILL = 0.4
WINDOW_RADIANCE = 6.0
LAMP_POWER = 400.0
LAMP_DISTANCE = 3.0
"""From the middle, scene units; a small lamp shines as much as a large one."""


def add_table(table: Table) -> list[bpy.types.Object]:
    """Adds the table with its upper side at z = 0, its texture seen from above, and its foot."""
    finish, size = material("table", table.finish), table.size
    if table.shape == "square":
        shape, drop = box((2.0 * size, 2.0 * size, THICKNESS)), -0.5 * THICKNESS
    else:
        shape, drop = cylinder(size, THICKNESS, rounding=0.4 * THICKNESS), -THICKNESS
    turn = (0.0, 0.0, table.turn)
    # one unit of the texture is two scene units: a cloth has the same threads on any table
    flat = [shape.vertices[list(face), :2] / 2.0 + 0.5 for face in shape.faces]
    seen = Shape(shape.vertices, shape.faces, flat)
    top = add_object("table", seen, finish, Pose((0.0, 0.0, drop), turn))
    leg = cylinder(0.12, -FLOOR - THICKNESS)
    return [top, add_object("foot", leg, finish, Pose((0.0, 0.0, FLOOR)))]


def add_light(recipe: PhotoRecipe, poses: np.ndarray, environment_file: Path) -> lights.LightRig:
    """Adds room or map, and what shines.

    Args:
        recipe: says what.
        poses: (V, 4, 4) of all cameras; a room holds them.
        environment_file: where the map is written for Blender to read.

    Returns:
        The map with its lamps; a room is told of by a black map.
    """
    light = recipe.light
    if light.kind in ("window", "lamp"):
        half = max(HALF_ROOM, 1.1 * float(np.abs(poses[:, :2, 3]).max()) * np.sqrt(2.0) + 0.4)
        height = max(CEILING, float(poses[:, 2, 3].max()) + 0.6)
        _add_room(light, half, height)
        if light.kind == "window":
            _add_window(light, half, height)
        else:
            _add_lamp(light)
        dark = np.zeros((8, 16, 3), dtype=np.float32)
        return lights.LightRig(dark, np.array([0.0, 0.0, 1.0]), np.zeros(3))
    suns = ()
    if light.kind == "sun":
        suns = (Sun(light.elevation, light.azimuth, light.size, light.share),)
    sky = Sky(light.turn, suns, is_softened=True)
    nobody = Cameras("dome", (0.0, 0.0), (0.0, 0.0), 1.0)
    request = SceneRequest(
        scene="drawn", ground="none", light="lamp" if suns else "hdri-sun", hdri=light.file,
        recipe=Recipe((), None, sky, nobody, recipe.second_light),
    )  # fmt: skip
    rig = lights.light_rig(request, np.random.default_rng(0))
    write_environment(environment_file, rig.environment)
    lights.add_lights(rig, environment_file)
    for lamp in [o for o in bpy.context.scene.objects if o.type == "LIGHT"]:
        lamp.visible_camera = False
    return rig


def _add_room(light: Light, half: float, height: float) -> None:
    """Walls, floor and ceiling, turned so that +x is where the window is."""
    turn = (0.0, 0.0, light.azimuth)
    wall = material("wall", light.wall)
    room = box((2.0 * half, 2.0 * half, height - FLOOR))
    # one unit of the texture is four scene units
    wide = [uv * np.array([half / 2.0, (height - FLOOR) / 4.0]) for uv in room.uvs]
    inside = Shape(room.vertices, [face[::-1] for face in room.faces], [u[::-1] for u in wide])
    add_object("room", inside, wall, Pose((0.0, 0.0, 0.5 * (FLOOR + height)), turn))


def _add_window(light: Light, half: float, height: float) -> None:
    """Panes that shine, with bars between them, in the wall."""
    turn = Pose(degrees=(0.0, 0.0, light.azimuth))
    low, high = WINDOW_SILL, min(WINDOW_SILL + 1.3 * light.size, height - 0.3)
    frame = material("frame", light.wall)
    wide, tall = light.size / PANES[0], (high - low) / PANES[1]
    for column in range(PANES[0]):
        for row in range(PANES[1]):
            y = (column + 0.5) * wide - 0.5 * light.size
            pane = bpy.data.lights.new("pane", "AREA")
            pane.shape, pane.size, pane.size_y = "RECTANGLE", tall - BAR, wide - BAR
            # Blender spreads the watts of a flat lamp over a half space
            pane.energy = WINDOW_RADIANCE * np.pi * pane.size * pane.size_y
            middle = low + (row + 0.5) * tall
            place = Pose((half - 0.03, y, middle), (0.0, 90.0, 0.0))
            _add_lamp_object(pane, light.tint, turn.matrix() @ place.matrix())
            seen = box((0.01, wide - BAR, tall - BAR))
            _add_sight(seen, light.tint, WINDOW_RADIANCE, Pose((half - 0.02, y, middle)), turn)
    bars = [(0.5 * BAR, light.size, BAR, 0.0, low + row * tall) for row in range(PANES[1] + 1)]
    bars += [
        (0.5 * BAR, BAR, high - low, column * wide - 0.5 * light.size, 0.5 * (low + high))
        for column in range(PANES[0] + 1)
    ]
    for deep, across, up, y, z in bars:
        add_object("bar", box((deep, across, up)), frame, Pose((half - 0.06, y, z)), turn)


def _add_lamp(light: Light) -> None:
    """A shining ball above, to one side."""
    elevation, azimuth = np.radians([light.elevation, light.azimuth])
    flat = LAMP_DISTANCE * np.cos(elevation)
    place = (flat * np.cos(azimuth), flat * np.sin(azimuth), LAMP_DISTANCE * np.sin(elevation))
    x, y, z = (float(v) for v in place)
    ball = bpy.data.lights.new("lamp", "POINT")
    ball.shadow_soft_size = light.size
    ball.energy = LAMP_POWER
    _add_lamp_object(ball, light.tint, Pose((x, y, z)).matrix())
    radiance = LAMP_POWER / (2.0 * np.pi * light.size) ** 2
    _add_sight(sphere(0.99 * light.size), light.tint, radiance, Pose((x, y, z)), Pose())


def _add_lamp_object(lamp: bpy.types.Light, tint: Rgb, place: Matrix) -> None:
    lamp.color = tint
    obj = bpy.data.objects.new(lamp.name, lamp)
    obj.matrix_world = place
    bpy.context.scene.collection.objects.link(obj)


def _add_sight(shape: Shape, tint: Rgb, radiance: float, place: Pose, parent: Pose) -> None:
    """What cameras see where a lamp of Blender's is, which they do not see; it lights nothing."""
    glow = bpy.data.materials.new("glow")
    if bpy.app.version < (5, 0, 0):
        glow.use_nodes = True
    nodes, links = glow.node_tree.nodes, glow.node_tree.links
    shine = nodes.new("ShaderNodeEmission")
    shine.inputs["Color"].default_value = (*tint, 1.0)
    shine.inputs["Strength"].default_value = radiance
    output = next(node for node in nodes if node.type == "OUTPUT_MATERIAL")
    links.new(shine.outputs["Emission"], output.inputs["Surface"])
    glow.cycles.emission_sampling = "NONE"
    seen = add_object("glow", shape, glow, place, parent)
    for ray in ("diffuse", "glossy", "transmission", "shadow", "volume_scatter"):
        setattr(seen, f"visible_{ray}", False)


def only(pieces: list[bpy.types.Object]) -> None:
    """Hides everything but the thing and the camera."""
    for obj in bpy.context.scene.objects:
        if obj.type in ("MESH", "LIGHT") and obj not in pieces:
            obj.hide_render = True
