# SPDX-License-Identifier: GPL-3.0-or-later
"""The asset as a mesh object with UVs and a Principled material."""

from pathlib import Path

import bpy
import numpy as np

from .blocks import MARK, enable_nodes, load_image
from .gateway import JobPaths
from .glb import GlbMesh


def texture_sockets(paths: JobPaths) -> list[tuple[Path, str, str]]:
    """Texture files of the material with the socket they feed and their colour space."""
    files = {
        "Base Color": (paths.textures / "albedo.png", "sRGB"),
        "Roughness": (paths.textures / "roughness.png", "Non-Color"),
        "Metallic": (paths.textures / "metallic.png", "Non-Color"),
    }
    if not files["Metallic"][0].is_file():  # written only where something is metal
        del files["Metallic"]
    return [(file, socket, space) for socket, (file, space) in files.items()]


def add_asset(mesh: GlbMesh, name: str, paths: JobPaths, mark: str) -> bpy.types.Object:
    """The object in the capture's frame, not yet linked to a collection."""
    data = bpy.data.meshes.new(mesh.name)
    data[MARK] = mark
    data.from_pydata(mesh.vertices.tolist(), [], mesh.faces.tolist())
    layer = data.uv_layers.new(name="UVMap")
    layer.uv.foreach_set("vector", mesh.corner_uvs.reshape(-1).astype(np.float32))
    data.polygons.foreach_set("use_smooth", np.ones(len(mesh.faces), dtype=bool))
    data.normals_split_custom_set(mesh.corner_normals.reshape(-1, 3).tolist())
    data.materials.append(_material(name, mesh.specular, paths, mark))
    data.update()
    asset = bpy.data.objects.new(mesh.name, data)
    asset[MARK] = mark
    return asset


def _material(name: str, specular: float, paths: JobPaths, mark: str) -> bpy.types.Material:
    """Principled material from the texture files; IOR stays Blender's 1.5, specular is a share."""
    material = bpy.data.materials.new(name)
    material[MARK] = mark
    enable_nodes(material)
    nodes, links = material.node_tree.nodes, material.node_tree.links
    shader = next(node for node in nodes if node.type == "BSDF_PRINCIPLED")
    shader.inputs["Specular IOR Level"].default_value *= specular  # 0.5: as the IOR says
    for row, (file, socket, space) in enumerate(texture_sockets(paths)):
        texture = nodes.new("ShaderNodeTexImage")
        texture.location = (-420, 300 - 300 * row)
        texture.label = socket
        texture.image = load_image(file, space, mark)
        links.new(texture.outputs["Color"], shader.inputs[socket])
    return material
