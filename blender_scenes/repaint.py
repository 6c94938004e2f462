# SPDX-License-Identifier: GPL-3.0-or-later
"""Puts a variation on the object of the open scene: other paint, finer textures, thin rods."""

import bpy
import numpy as np

from blender_scenes.objects import Pose, add_object, principled, principled_node
from blender_scenes.shapes import cylinder
from blender_scenes.variation import ALBEDO, Variation

ROD_HEIGHT = 0.5
ROD_RING = 0.8
"""Distance of the rods from the middle, scene units: beside the object, on the ground plate."""

ROD_COLOUR = (0.45, 0.2, 0.08)


def repaint(variation: Variation) -> None:
    """Changes every material there is, then adds the rods; what comes later stays as it is.

    Args:
        variation: what differs from the scene as it was built.
    """
    for material in bpy.data.materials:
        _repaint(material, variation)
    if variation.rods is not None:
        rod = cylinder(variation.rods, ROD_HEIGHT)
        paint = principled("rod", ROD_COLOUR, 0.5)
        for turn in 2.0 * np.pi * np.arange(8) / 8:
            place = (ROD_RING * float(np.cos(turn)), ROD_RING * float(np.sin(turn)), 0.0)
            add_object("rod", rod, paint, Pose(place))


def _repaint(material: bpy.types.Material, variation: Variation) -> None:
    shader, links = principled_node(material), material.node_tree.links
    for name, value in (("Roughness", variation.roughness), ("Metallic", variation.metallic)):
        if value is not None:
            for link in list(shader.inputs[name].links):
                links.remove(link)
            shader.inputs[name].default_value = value
    if variation.albedo is not None:
        _mix(material, *ALBEDO[variation.albedo])
    if variation.texture_scale != 1.0:
        for node in [n for n in material.node_tree.nodes if n.type == "TEX_IMAGE"]:
            _refine(material, node, variation.texture_scale)


def _mix(material: bpy.types.Material, gain: float, offset: float) -> None:
    """Base colour times `gain` plus `offset`."""
    socket, links = principled_node(material).inputs["Base Color"], material.node_tree.links
    if not socket.is_linked:
        socket.default_value = [*(gain * c + offset for c in socket.default_value[:3]), 1.0]
        return
    node = material.node_tree.nodes.new("ShaderNodeVectorMath")
    node.operation = "MULTIPLY_ADD"
    node.inputs[1].default_value = [gain] * 3
    node.inputs[2].default_value = [offset] * 3
    links.new(socket.links[0].from_socket, node.inputs[0])
    links.new(node.outputs["Vector"], socket)


def _refine(material: bpy.types.Material, image: bpy.types.Node, scale: float) -> None:
    """Repeats an image texture `scale` times along u and v."""
    nodes, links = material.node_tree.nodes, material.node_tree.links
    mapping = nodes.new("ShaderNodeMapping")
    mapping.inputs["Scale"].default_value = [scale] * 3
    vector = image.inputs["Vector"]
    if vector.is_linked:
        source = vector.links[0].from_socket
    else:
        source = nodes.new("ShaderNodeTexCoord").outputs["UV"]
    links.new(source, mapping.inputs["Vector"])
    links.new(mapping.outputs["Vector"], vector)
