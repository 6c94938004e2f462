# SPDX-License-Identifier: GPL-3.0-or-later
"""The user's own object without the light in its texture: what is handed out, what comes back.

The object goes to the engine as a PLY in the capture's frame, every triangle with corners of its
own, in the order Blender has them. What comes back is a material beside those it has, and the
recovered light as the scene's World.
"""

import hashlib
from pathlib import Path

import bpy
import numpy as np

from ..blocks import numbers_of, with_mark
from ..engine.errors import RequestError, ResultError
from ..gateway import JobPaths, read_record, replacing
from ..words import told
from .glb import read_glb
from .importer import bring_in, import_light, light_up, mark_of
from .materials import new_material, refresh_material, refresh_pictures

# custom property of an object: the result folder its new material comes from
TARGET = "robir_delit"
_BEFORE = "robir_material_before"  # attribute of a mesh's faces: the slots they had before

_HEAD = """ply
format binary_little_endian 1.0
element vertex {vertices}
property float x
property float y
property float z
{uv}element face {faces}
property list uchar int vertex_indices
end_header
"""

_GEOMETRY = {"metrics": {"layout": str}}


def mesh_file(target: bpy.types.Object, settings: bpy.types.PropertyGroup, result: Path) -> Path:
    """Write an object as it stands in the scene, modifiers included, beside a result folder."""
    points, uvs = _corners(target)
    points = (points - np.array(settings.view_shift)) / settings.view_scale
    if not len(points):
        raise RequestError(
            "{name} has no faces; select the object that was photographed", name=target.name
        )
    corners = [points, uvs] if uvs is not None else [points]
    faces = np.empty(len(points) // 3, [("count", "u1"), ("corners", "<i4", 3)])
    faces["count"], faces["corners"] = 3, np.arange(len(points)).reshape(-1, 3)
    head = _HEAD.format(
        vertices=len(points),
        faces=len(faces),
        uv="" if uvs is None else "property float s\nproperty float t\n",
    )
    content = head.encode() + np.hstack(corners).astype("<f4").tobytes() + faces.tobytes()
    digest = hashlib.sha256(content).hexdigest()[:8]
    file = result.with_name(f"{result.name}_delit_{digest}.ply")
    with replacing(file) as temporary:
        temporary.write_bytes(content)
    return file


def _corners(target: bpy.types.Object) -> tuple[np.ndarray, np.ndarray | None]:
    """Places (3 F, 3) in the world of the triangles' corners, and their places in the texture."""
    shown = target.evaluated_get(bpy.context.evaluated_depsgraph_get())
    mesh = shown.to_mesh()
    try:
        mesh.calc_loop_triangles()
        loops = numbers_of(mesh.loop_triangles, "loops", 3, np.int32).ravel()
        of_loop = numbers_of(mesh.loops, "vertex_index", kind=np.int32).ravel()
        vertices, world = numbers_of(mesh.vertices, "co", 3), np.array(target.matrix_world)
        points = vertices[of_loop[loops]] @ world[:3, :3].T + world[:3, 3]
        layer = next((layer for layer in mesh.uv_layers if layer.active_render), None)
        if layer is None:
            return points, None
        return points, numbers_of(layer.uv, "vector", 2)[loops]
    finally:
        shown.to_mesh_clear()


def target_of(root: Path) -> bpy.types.Object | None:
    """The object of the scene's file that a result folder was made for, if any."""
    mark = mark_of(root)
    return next((o for o in bpy.data.objects if o.type == "MESH" and o.get(TARGET) == mark), None)


def has_own_layout(root: Path) -> bool:
    """Whether textures were made for the texture coordinates that the user's mesh brought."""
    file = JobPaths(Path(mark_of(root))).manifest("geometry")
    try:
        layout = read_record(file, _GEOMETRY)["metrics"]["layout"]
    except (OSError, ValueError) as fault:
        raise ResultError("{file} cannot be read ({fault})", file=file, fault=fault) from fault
    return layout == "own"


def give_back(context: bpy.types.Context, root: Path) -> list[str]:
    """Give the object its new material and the scene the recovered light."""
    target, mark, scene = target_of(root), mark_of(root), context.scene
    assert target is not None
    paths = JobPaths(Path(mark))
    if not has_own_layout(root):
        return [
            *bring_in(context, root),
            told(
                "{name} has no texture coordinates that textures could be made for, so the result "
                "is an object of its own; give it a UV Map without overlaps to have it there",
                name=target.name,
            ),
        ]
    specular = read_glb(paths.asset).specular
    import_light(root, scene, use_sun_lamp=scene.robir.use_sun_lamp)
    scene.robir.result = str(root)
    material = next(iter(with_mark(bpy.data.materials, mark)), None)
    if material is None:
        material = new_material(f"{target.name} de-lit", specular, paths, mark)
    else:
        refresh_pictures(paths, mark)
        refresh_material(material, specular, paths)
    _show(target.data, material)
    light_up(context)
    text = "{name} has the new material {material} beside those it had"
    return [told(text, name=target.name, material=material.name)]


def _show(mesh: bpy.types.Mesh, material: bpy.types.Material) -> None:
    """Give all faces a material in a slot of its own; the slots they had are remembered."""
    if material.name not in mesh.materials:
        slots = numbers_of(mesh.polygons, "material_index", kind=np.int32).ravel()
        before = mesh.attributes.get(_BEFORE) or mesh.attributes.new(_BEFORE, "INT", "FACE")
        before.data.foreach_set("value", slots)
        if not len(mesh.materials):
            mesh.materials.append(None)  # what it had: none
        mesh.materials.append(material)
    index = mesh.materials.find(material.name)
    mesh.polygons.foreach_set("material_index", np.full(len(mesh.polygons), index, np.int32))
    mesh.update()
