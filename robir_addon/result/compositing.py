# SPDX-License-Identifier: GPL-3.0-or-later
"""What is laid about and over an object: its photograph with a shadow, and where views are few."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import bpy
from mathutils import Vector

from ..blocks import MARK, are_there, enable_nodes, load_image, viewports, with_mark
from ..capture.cameras import capture_cameras, use_camera
from ..engine.errors import ResultError
from .placing import middle_of_foot

# custom property of the ground: whether the film was transparent before
_GROUND = "robir_shadow_ground"
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
    for area in viewports(scene):
        area.spaces.active.region_3d.view_perspective = "CAMERA"


def clear_stage(scene: bpy.types.Scene, mark: str) -> bool:
    """Take the ground of a result away; whether there was one."""
    found = [data for data in with_mark(bpy.data.meshes, mark) if data.name.startswith("RobIR g")]
    floors = [o for o in scene.objects if _GROUND in o and o.data in found]
    for floor in floors:
        scene.render.film_transparent = bool(floor[_GROUND])
    bpy.data.batch_remove([*floors, *found])
    return bool(floors)


_SHOWN = "robir_few_views"  # custom property of what lies over an object: the result's mark
_FEW = 3  # photographs below which light and material of a place are hardly told apart
_LIFT = 0.003  # how far above the object the tint lies, longest sides
_UNSEEN, _BARELY = (0.8, 0.02, 0.02, 1.0), (0.9, 0.35, 0.02, 0.8)


def stops(photographs: int) -> list[tuple[float, tuple[float, ...]]]:
    """Shares of the photographs from which on a colour holds: none, few, enough see a place."""
    ends = (0.0, 0.5, _FEW - 0.5)
    colours = (_UNSEEN, _BARELY, (*_BARELY[:3], 0.0))
    return [(end / photographs, colour) for end, colour in zip(ends, colours, strict=True)]


def show_few_views(asset: bpy.types.Object, coverage: Path, photographs: int, mark: str) -> None:
    """Lay the tint over an object; `coverage` is the share of photographs that see each texel."""
    if not are_there(coverage):
        raise ResultError("{file} is missing; export the result again", file=coverage.name)
    over = bpy.data.objects.new(f"{asset.name} few views", asset.data)
    over[_SHOWN] = mark
    over.parent, over.hide_select, over.hide_render = asset, True, True
    lift = over.modifiers.new("RobIR lift", "DISPLACE")
    lift.mid_level, lift.strength = 0.0, _LIFT * max(asset.dimensions)
    asset.users_collection[0].objects.link(over)
    tint = bpy.data.materials.new(over.name)
    tint[_SHOWN] = mark
    for slot in over.material_slots:
        slot.link, slot.material = "OBJECT", tint
    enable_nodes(tint)
    nodes, links = tint.node_tree.nodes, tint.node_tree.links
    nodes.clear()
    kinds = ("TexImage", "ValToRGB", "Emission", "BsdfTransparent", "MixShader", "OutputMaterial")
    picture, ramp, shine, clear, mix, end = (nodes.new(f"ShaderNode{kind}") for kind in kinds)
    picture.image = load_image(coverage, "Non-Color", mark)
    levels = ramp.color_ramp
    levels.interpolation = "CONSTANT"
    levels.elements.new(0.5)
    for level, (levels_at, colour) in zip(levels.elements, stops(photographs), strict=True):
        level.position, level.color = levels_at, colour
    links.new(picture.outputs["Color"], ramp.inputs["Fac"])
    links.new(ramp.outputs["Color"], shine.inputs["Color"])
    links.new(ramp.outputs["Alpha"], mix.inputs["Fac"])
    links.new(clear.outputs["BSDF"], mix.inputs[1])
    links.new(shine.outputs["Emission"], mix.inputs[2])
    links.new(mix.outputs["Shader"], end.inputs["Surface"])


def hide_few_views(mark: str) -> bool:
    """Take the tint of a result away; whether there was one."""
    kinds = (bpy.data.objects, bpy.data.materials)
    found = [block for blocks in kinds for block in blocks if block.get(_SHOWN) == mark]
    bpy.data.batch_remove(found)
    return bool(found)
