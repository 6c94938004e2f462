# SPDX-License-Identifier: GPL-3.0-or-later
"""Where to photograph next: parts of a result that no or few photographs show, tinted over it."""

from pathlib import Path

import bpy

from ..blocks import are_there, enable_nodes, load_image
from ..errors import ResultError

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
    """Lay the tint over an object.

    Args:
        asset: The imported object; the tint goes with its place and its mesh.
        coverage: Texture of the share of the photographs that see each texel.
        photographs: Number of those that the result was made of.
        mark: Of the result.
    """
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
