# SPDX-License-Identifier: GPL-3.0-or-later
"""Any OBJ or glTF file, one unit in size, standing on the ground plate."""

from pathlib import Path

import bpy
import numpy as np
from mathutils import Matrix, Vector

from blender_scenes.objects import principled_node
from blender_scenes.request import SceneError, SceneRequest

SIZE = 1.0
"""Longest side of the asset's bounding box, scene units."""

KEPT_SOCKETS = ("Base Color", "Roughness", "Metallic")


def build(request: SceneRequest, rng: np.random.Generator) -> None:
    """Imports `request.asset`, keeps base colour, roughness and metallic, and turns it by `rng`."""
    if request.asset is None:
        raise SceneError("scene 'asset' needs --asset FILE (an .obj, .gltf or .glb file)")
    meshes = _import(request.asset)
    for material in {m for obj in meshes for m in obj.data.materials if m is not None}:
        _keep_plain(material, request.asset)
    _normalise(meshes, float(rng.uniform(0.0, 360.0)))


def _import(file: Path) -> list[bpy.types.Object]:
    before = set(bpy.data.objects)
    try:
        if file.suffix.lower() == ".obj":
            bpy.ops.wm.obj_import(filepath=str(file))
        else:
            bpy.ops.import_scene.gltf(filepath=str(file))
    except RuntimeError as error:
        raise SceneError(f"--asset {file}: Blender cannot import it ({error})") from error
    meshes = [o for o in bpy.data.objects if o not in before and o.type == "MESH"]
    if not meshes or not any(len(o.data.polygons) for o in meshes):
        raise SceneError(f"--asset {file}: holds no faces; give a file with a mesh")
    for obj in meshes:
        if not any(obj.data.materials):
            obj.data.materials.clear()
            obj.data.materials.append(_plain_material())
    return meshes


def _plain_material() -> bpy.types.Material:
    material = bpy.data.materials.new("plain")
    if bpy.app.version < (5, 0, 0):
        material.use_nodes = True
    return material


def _keep_plain(material: bpy.types.Material, file: Path) -> None:
    """Unlinks and resets every Principled input but the three that the ground truth describes."""
    if not material.node_tree or not any(
        n.type == "BSDF_PRINCIPLED" for n in material.node_tree.nodes
    ):
        raise SceneError(
            f"--asset {file}: material {material.name!r} has no Principled shader; give it one"
        )
    shader = principled_node(material)
    fresh = _plain_material()
    for socket, default in zip(shader.inputs, principled_node(fresh).inputs, strict=True):
        if socket.name in KEPT_SOCKETS:
            continue
        for link in list(socket.links):
            material.node_tree.links.remove(link)
        if hasattr(socket, "default_value"):
            socket.default_value = default.default_value
    bpy.data.materials.remove(fresh)


def _normalise(meshes: list[bpy.types.Object], degrees: float) -> None:
    """Scales the group to SIZE, sets it on z = 0 over the origin and turns it about z."""
    bpy.context.view_layer.update()
    corners = np.concatenate(
        [
            [(o.matrix_world @ v.co)[:] for v in o.data.vertices]
            for o in meshes
            if len(o.data.vertices)
        ]
    )
    low, high = corners.min(axis=0), corners.max(axis=0)
    middle = Vector([*(0.5 * (low + high))[:2], low[2]])
    fit = (
        Matrix.Rotation(np.radians(degrees), 4, "Z")
        @ Matrix.Scale(SIZE / float((high - low).max()), 4)
        @ Matrix.Translation(-middle)
    )
    for obj in meshes:
        obj.data = obj.data.copy() if obj.data.users > 1 else obj.data
        obj.data.transform(obj.matrix_world)
    for obj in meshes:
        obj.parent = None
        obj.matrix_world = fit
