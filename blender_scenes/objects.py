# SPDX-License-Identifier: GPL-3.0-or-later
"""Blender objects and Principled materials with their ground-truth outputs."""

from dataclasses import dataclass
from math import radians

import bpy
import numpy as np
from mathutils import Euler, Matrix, Vector

from blender_scenes import textures
from blender_scenes.shapes import Shape, cylinder

Value = float | np.ndarray
Triple = tuple[float, float, float]

GROUND_RADIUS = 0.98
GROUND_THICKNESS = 0.03

TRUTH_SOCKETS = {"albedo": "Base Color", "roughness": "Roughness", "metallic": "Metallic"}
"""Name of the ground-truth pass -> socket of the Principled node it shows."""


@dataclass(frozen=True)
class Pose:
    """Where an object stands: location in scene units, Euler angles in degrees, uniform scale."""

    location: Triple = (0.0, 0.0, 0.0)
    degrees: Triple = (0.0, 0.0, 0.0)
    scale: float = 1.0

    def matrix(self) -> Matrix:
        """Object-to-world transform."""
        turn = Euler([radians(d) for d in self.degrees])
        return Matrix.LocRotScale(Vector(self.location), turn, Vector([self.scale] * 3))


def add_object(
    name: str,
    shape: Shape,
    material: bpy.types.Material,
    pose: Pose = Pose(),
    parent: Pose = Pose(),
    bevel: float = 0.0,
) -> bpy.types.Object:
    """Adds a shape to the open scene.

    Args:
        name: object name.
        shape: geometry.
        material: its only material.
        pose: transform within `parent`.
        parent: transform of the group the object belongs to.
        bevel: width of rounded edges, scene units; 0 leaves them sharp.

    Returns:
        The object, linked to the scene.
    """
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(shape.vertices.tolist(), [], [list(f) for f in shape.faces])
    layer = mesh.uv_layers.new(name="UVMap")
    layer.uv.foreach_set("vector", np.concatenate(shape.uvs).astype(np.float32).ravel())
    mesh.materials.append(material)
    mesh.shade_smooth()
    mesh.set_sharp_from_angle(angle=radians(35.0))
    obj = bpy.data.objects.new(name, mesh)
    obj.matrix_world = parent.matrix() @ pose.matrix()
    bpy.context.scene.collection.objects.link(obj)
    if bevel > 0.0:
        modifier = obj.modifiers.new("bevel", "BEVEL")
        modifier.width = bevel
        modifier.segments = 3
        modifier.harden_normals = True
    return obj


def principled(
    name: str, base: Triple | np.ndarray, roughness: Value, metallic: float = 0.0
) -> bpy.types.Material:
    """Material of a Principled node and nothing else.

    Args:
        name: material name.
        base: base colour, linear Rec.709: one colour or an (H, W, 3) texture.
        roughness: one value or an (H, W) texture, 0..1.
        metallic: 0..1.

    Returns:
        The material; `add_truth_outputs` makes its values visible to the render passes.
    """
    material = bpy.data.materials.new(name)
    if bpy.app.version < (5, 0, 0):
        material.use_nodes = True
    shader = principled_node(material)
    for socket, value in (("Base Color", base), ("Roughness", roughness), ("Metallic", metallic)):
        if isinstance(value, np.ndarray):
            node = material.node_tree.nodes.new("ShaderNodeTexImage")
            node.image = _image(f"{name}_{socket}", value)
            material.node_tree.links.new(node.outputs["Color"], shader.inputs[socket])
        else:
            shader.inputs[socket].default_value = (
                (*value, 1.0) if isinstance(value, tuple) else value
            )
    return material


def principled_node(material: bpy.types.Material) -> bpy.types.Node:
    """The material's Principled node."""
    return next(n for n in material.node_tree.nodes if n.type == "BSDF_PRINCIPLED")


def add_truth_outputs(material: bpy.types.Material) -> None:
    """Shows base colour, roughness and metallic of a material to the passes of those names."""
    tree = material.node_tree
    shader = principled_node(material)
    for aov, socket_name in TRUTH_SOCKETS.items():
        socket = shader.inputs[socket_name]
        node = tree.nodes.new("ShaderNodeOutputAOV")
        node.aov_name = aov
        target = node.inputs["Color" if aov == "albedo" else "Value"]
        if socket.is_linked:
            tree.links.new(socket.links[0].from_socket, target)
        else:
            target.default_value = socket.default_value


def _image(name: str, values: np.ndarray) -> bpy.types.Image:
    """Float image holding linear data (H, W) or (H, W, 3), first row at the bottom."""
    height, width = values.shape[:2]
    image = bpy.data.images.new(name, width, height, float_buffer=True)
    # the tag must come first: setting it afterwards drops the pixels
    image.colorspace_settings.name = "Linear Rec.709" if values.ndim == 3 else "Non-Color"
    pixels = np.ones((height, width, 4), dtype=np.float32)
    pixels[..., :3] = values if values.ndim == 3 else values[..., None]
    image.pixels.foreach_set(pixels.ravel())
    image.update()
    return image


def add_ground(kind: str, rng: np.random.Generator) -> None:
    """Adds a round plate with its upper side at z = 0; kind "none" adds nothing."""
    if kind == "none":
        return
    base = textures.ground(kind, rng)
    shape = cylinder(GROUND_RADIUS, GROUND_THICKNESS, rounding=0.4 * GROUND_THICKNESS)
    uvs = [shape.vertices[list(face), :2] / (2.0 * GROUND_RADIUS) + 0.5 for face in shape.faces]
    flat = Shape(shape.vertices, shape.faces, uvs)
    add_object(
        "ground", flat, principled("ground", base, 0.75), Pose((0.0, 0.0, -GROUND_THICKNESS))
    )
