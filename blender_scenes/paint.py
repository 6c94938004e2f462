# SPDX-License-Identifier: GPL-3.0-or-later
"""Materials from a written paint: one colour, image textures, or Blender's procedural ones."""

import bpy
import numpy as np

from blender_scenes import textures
from blender_scenes.objects import principled, principled_node
from blender_scenes.recipe import PROCEDURAL, Paint, Rgb

TEXTURE_SIZE = 512
"""Side of an image texture in texels: finer than a photograph of 256 pixels resolves."""

BLEND = 0.1
"""Width over which the sides of a box projection go over into each other."""

SPOTTED_SHARE = 0.3
"""Share of a speckled surface that spots cover."""

_NODES = {
    "noise": "ShaderNodeTexNoise",
    "cells": "ShaderNodeTexVoronoi",
    "waves": "ShaderNodeTexWave",
}
_THRESHOLDS = {"noise": (0.45, 0.55), "cells": (0.3, 0.4), "waves": (0.45, 0.55)}
"""Where a procedural pattern goes over from the first colour to the second."""


def material(name: str, paint: Paint, seed: int, is_unwrapped: bool) -> bpy.types.Material:
    """The material that a paint describes.

    Args:
        name: of the material.
        paint: any but an asset's own.
        seed: decides the texture beyond what the paint says.
        is_unwrapped: whether the surface has texture coordinates; without, an image is projected
            along the axes of its bounding box.
    """
    first, second = paint.roughness
    if paint.pattern == "plain":
        return principled(name, paint.colours[0], first, paint.metallic)
    if paint.pattern in PROCEDURAL:
        return _procedural(name, paint, seed)
    base = _image(paint, paint.colours, seed)
    # the same texture in grey: the roughness changes where the colour does
    gloss = first if first == second else _image(paint, (_grey(first), _grey(second)), seed)[..., 0]
    made = principled(name, base, gloss, paint.metallic)
    if not is_unwrapped:
        _project(made)
    return made


def _grey(value: float) -> Rgb:
    return value, value, value


def _image(paint: Paint, colours: tuple[Rgb, Rgb], seed: int) -> np.ndarray:
    """An image texture (H, W, 3) of two colours; equal seeds give equal patterns."""
    rng = np.random.default_rng(seed)
    size, cells = TEXTURE_SIZE, paint.cells
    if paint.pattern == "checker":
        return textures.checker(size, 2 * cells, *colours)
    if paint.pattern == "stripes":
        return textures.stripes(size, cells, *colours, along_u=bool(seed % 2))
    if paint.pattern == "speckled":
        return textures.speckled(size, *colours, SPOTTED_SHARE, rng)
    if paint.pattern == "wood":
        return textures.wood(size, *colours, rng, planks=max(cells // 2, 1))
    return textures.mixed(*colours, textures.noise(size, cells, rng))


def _project(made: bpy.types.Material) -> None:
    """Projects the images of a material along the axes."""
    nodes, links = made.node_tree.nodes, made.node_tree.links
    coordinates = nodes.new("ShaderNodeTexCoord").outputs["Generated"]
    for node in [n for n in nodes if n.type == "TEX_IMAGE"]:
        node.projection = "BOX"
        node.projection_blend = BLEND
        links.new(coordinates, node.inputs["Vector"])


def _procedural(name: str, paint: Paint, seed: int) -> bpy.types.Material:
    """A pattern of Blender's in the coordinates of the thing's bounding box."""
    made = principled(name, paint.colours[0], paint.roughness[0], paint.metallic)
    nodes, links = made.node_tree.nodes, made.node_tree.links
    mapping = nodes.new("ShaderNodeMapping")
    mapping.inputs["Location"].default_value = np.random.default_rng(seed).uniform(0, 50, 3)
    links.new(nodes.new("ShaderNodeTexCoord").outputs["Generated"], mapping.inputs["Vector"])
    pattern = nodes.new(_NODES[paint.pattern])
    pattern.inputs["Scale"].default_value = float(paint.cells)
    links.new(mapping.outputs["Vector"], pattern.inputs["Vector"])
    height = next(socket for socket in pattern.outputs if socket.type == "VALUE")
    inputs = principled_node(made).inputs
    values = {"Base Color": paint.colours, "Roughness": tuple((r,) * 3 for r in paint.roughness)}
    for socket, pair in values.items():
        ramp = nodes.new("ShaderNodeValToRGB")
        for element, place, value in zip(
            ramp.color_ramp.elements, _THRESHOLDS[paint.pattern], pair, strict=True
        ):
            element.position, element.color = place, (*value, 1.0)
        links.new(height, ramp.inputs[0])
        links.new(ramp.outputs["Color"], inputs[socket])
    return made
