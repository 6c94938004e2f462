# SPDX-License-Identifier: GPL-3.0-or-later
"""Meshes from elsewhere: read from OBJ and glTF files, reduced to known materials, set in place."""

from collections.abc import Iterable
from pathlib import Path

import bpy
import numpy as np
from mathutils import Euler, Matrix, Vector

from blender_scenes.objects import principled_node
from blender_scenes.request import SceneError

KEPT_SOCKETS = ("Base Color", "Roughness", "Metallic")


def import_asset(file: Path, kept: Iterable[str] = KEPT_SOCKETS) -> list[bpy.types.Object]:
    """Imports a file; of its materials only some inputs stay, so that the truth describes them.

    Args:
        file: .obj, .gltf or .glb.
        kept: names of the Principled inputs that stay as they are.

    Returns:
        Its meshes.

    Raises:
        SceneError: Blender cannot read it, or it holds no faces or no Principled shader.
    """
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
    for material in {m for obj in meshes for m in obj.data.materials if m is not None}:
        _keep(material, file, tuple(kept))
    return meshes


def _plain_material() -> bpy.types.Material:
    material = bpy.data.materials.new("plain")
    if bpy.app.version < (5, 0, 0):
        material.use_nodes = True
    return material


def _keep(material: bpy.types.Material, file: Path, kept: tuple[str, ...]) -> None:
    """Unlinks and resets every Principled input but the given ones."""
    if not material.node_tree or not any(
        n.type == "BSDF_PRINCIPLED" for n in material.node_tree.nodes
    ):
        raise SceneError(
            f"--asset {file}: material {material.name!r} has no Principled shader; give it one"
        )
    shader = principled_node(material)
    fresh = _plain_material()
    for socket, default in zip(shader.inputs, principled_node(fresh).inputs, strict=True):
        if socket.name in kept:
            continue
        for link in list(socket.links):
            material.node_tree.links.remove(link)
        if hasattr(socket, "default_value"):
            socket.default_value = default.default_value
    bpy.data.materials.remove(fresh)


def stand(
    meshes: list[bpy.types.Object],
    size: float,
    degrees: tuple[float, float, float],
    place: tuple[float, float] = (0.0, 0.0),
) -> None:
    """Turns a group, scales it and sets it on z = 0.

    Args:
        meshes: the group, in its own frame.
        size: longest side of its bounding box before the turn, scene units.
        degrees: Euler angles.
        place: x and y of the middle of its bounding box: before the turn where that is about z
            alone, which keeps the axis of turned shapes in place.
    """
    bpy.context.view_layer.update()
    corners = np.concatenate(
        [
            [(o.matrix_world @ v.co)[:] for v in o.data.vertices]
            for o in meshes
            if len(o.data.vertices)
        ]
    )
    low, high = corners.min(axis=0), corners.max(axis=0)
    scale = size / float((high - low).max())
    turn = Euler(np.radians(degrees)).to_matrix()
    if any(degrees[:2]):
        corners = corners @ np.array(turn).T
        low, high = corners.min(axis=0), corners.max(axis=0)
        shift = Vector([*(-0.5 * (low + high))[:2], -low[2]])
        inner = Matrix.Translation(shift) @ turn.to_4x4()
    else:
        shift = Vector([*(-0.5 * (low + high))[:2], -low[2]])
        inner = turn.to_4x4() @ Matrix.Translation(shift)
    fit = Matrix.Translation((*place, 0.0)) @ Matrix.Scale(scale, 4) @ inner
    for obj in meshes:
        obj.data = obj.data.copy() if obj.data.users > 1 else obj.data
        obj.data.transform(obj.matrix_world)
    for obj in meshes:
        obj.parent = None
        obj.matrix_world = fit
