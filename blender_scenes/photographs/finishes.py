# SPDX-License-Identifier: GPL-3.0-or-later
"""Materials from a written finish: paint, print, cloth, wood, stone, with coat, sheen and bump."""

import bpy
import numpy as np

from blender_scenes import textures
from blender_scenes.objects import principled, principled_node
from blender_scenes.photographs.labels import label
from blender_scenes.photographs.recipe import Finish

SIZE = 1024
THREADS = 20
"""Threads of cloth along a texture with one cell."""

BUMP = {"weave": 0.35, "grain": 0.25, "clay": 0.3}
"""Strength of the bump node."""

BUMP_DISTANCE = 0.01
"""Height of a bump of strength 1, scene units."""

BUMP_SCALE = {"weave": 30.0, "grain": 25.0, "clay": 14.0}

THING = "thing"
"""Name of the pass that is 1 where a pixel shows the thing."""


def material(name: str, finish: Finish, *, is_unwrapped: bool = True) -> bpy.types.Material:
    """The material that a finish describes.

    Args:
        name: of the material.
        finish: any but an asset's own pattern.
        is_unwrapped: whether the surface has texture coordinates; without, images are projected
            along the axes of its bounding box.
    """
    base = finish.colours[0] if finish.pattern == "plain" else _image(finish)
    made = principled(name, base, finish.roughness, finish.metallic)
    inputs = principled_node(made).inputs
    inputs["Coat Weight"].default_value = finish.coat
    inputs["Coat Roughness"].default_value = 0.06
    inputs["Sheen Weight"].default_value = finish.sheen
    inputs["Sheen Roughness"].default_value = 0.4
    if not is_unwrapped:
        _project(made)
    if finish.bump != "none":
        _bump(made, finish)
    return made


def _image(finish: Finish) -> np.ndarray:
    """Base colours (SIZE, SIZE, 3), first row at the bottom."""
    rng = np.random.default_rng(finish.seed)
    first, second = finish.colours[:2]
    cells = finish.cells
    if finish.pattern == "label":
        return label(finish.colours, cells, rng)
    if finish.pattern == "checker":
        return textures.checker(SIZE, 2 * cells, first, second)
    if finish.pattern == "stripes":
        return textures.stripes(SIZE, cells, first, second, along_u=bool(finish.seed % 2))
    if finish.pattern == "speckled":
        return textures.speckled(SIZE, first, second, 0.25, rng)
    if finish.pattern == "wood":
        return textures.wood(SIZE, first, second, rng, planks=max(cells // 2, 1))
    if finish.pattern == "weave":
        u = 2.0 * np.pi * (np.arange(SIZE) + 0.5) / SIZE
        wave = np.sin(THREADS * u)
        threads = 0.5 + 0.5 * wave[None, :] * np.sign(wave)[:, None]
        stains = textures.noise(SIZE, 2 * cells, rng)
        return textures.mixed(first, second, np.clip(0.45 * threads + 0.7 * stains, 0.0, 1.0))
    field = textures.noise(SIZE, cells, rng, octaves=5)
    if finish.pattern == "stone":
        veins = np.exp(-((textures.noise(SIZE, cells, rng, octaves=5) - 0.5) ** 2) / 0.0008)
        grains = textures.noise(SIZE, 64, rng, octaves=3)
        field = np.clip(0.5 * field + 0.35 * grains + 0.6 * veins, 0.0, 1.0)
    return textures.mixed(first, second, field)


def _project(made: bpy.types.Material) -> None:
    nodes, links = made.node_tree.nodes, made.node_tree.links
    coordinates = nodes.new("ShaderNodeTexCoord").outputs["Generated"]
    for node in [n for n in nodes if n.type == "TEX_IMAGE"]:
        node.projection = "BOX"
        node.projection_blend = 0.1
        links.new(coordinates, node.inputs["Vector"])


def _bump(made: bpy.types.Material, finish: Finish) -> None:
    """Small relief in the thing's own coordinates; the colour knows nothing of it."""
    nodes, links = made.node_tree.nodes, made.node_tree.links
    where = nodes.new("ShaderNodeTexCoord").outputs["Object"]
    if finish.bump == "weave":
        relief = nodes.new("ShaderNodeTexVoronoi")
        relief.inputs["Randomness"].default_value = 0.15
        height = relief.outputs["Distance"]
    else:
        relief = nodes.new("ShaderNodeTexNoise")
        height = next(socket for socket in relief.outputs if socket.type == "VALUE")
    relief.inputs["Scale"].default_value = BUMP_SCALE[finish.bump]
    links.new(where, relief.inputs["Vector"])
    bump = nodes.new("ShaderNodeBump")
    bump.inputs["Strength"].default_value = BUMP[finish.bump]
    bump.inputs["Distance"].default_value = BUMP_DISTANCE
    links.new(height, bump.inputs["Height"])
    links.new(bump.outputs["Normal"], principled_node(made).inputs["Normal"])


def mark_thing(made: bpy.types.Material) -> None:
    """Makes a material show itself in the pass THING."""
    node = made.node_tree.nodes.new("ShaderNodeOutputAOV")
    node.aov_name = THING
    node.inputs["Value"].default_value = 1.0
