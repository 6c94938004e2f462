# SPDX-License-Identifier: Apache-2.0
"""The white material of surfaces whose radiance tells what light they receive."""


def white():
    """Diffuse, of albedo 1. Its source also runs in a Blender of its own."""
    import bpy

    material = bpy.data.materials.new("white")
    if bpy.app.version < (5, 0, 0):
        material.use_nodes = True
    nodes = material.node_tree.nodes
    nodes.clear()
    shader = nodes.new("ShaderNodeBsdfDiffuse")
    shader.inputs["Color"].default_value = (1, 1, 1, 1)
    output = nodes.new("ShaderNodeOutputMaterial")
    material.node_tree.links.new(shader.outputs[0], output.inputs["Surface"])
    return material
