# SPDX-License-Identifier: GPL-3.0-or-later
"""The object as games want it: on the floor, of few triangles, its fine shape in a normal map.

All is done to copies that are there for as long as files are written.
"""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from typing import Any

import bpy
import numpy as np
from mathutils import Matrix

from ..blocks import MARK, only_selected
from ..engine.errors import ResultError
from .placing import GROUND_SHARE, crumbs, delete_faces, faces_of_ground, middle_of_foot, points_of

_CAGE = 0.3  # how far from the coarse surface the fine one is looked for, widths of a triangle
_MARGIN = 8  # texels that the normal map goes on beyond its charts


@contextmanager
def dense_copy(
    asset: bpy.types.Object, table: Mapping[str, Any], size: float, *, is_cleaned: bool
) -> Iterator[bpy.types.Object]:
    """A copy without transform at the origin, so long (0: as it is), without ground and crumbs."""
    copy = asset.copy()
    copy.data = asset.data.copy()
    meshes = [copy.data]
    for block in (copy, copy.data):
        del block[MARK]  # it is no result of its own
    asset.users_collection[0].objects.link(copy)
    try:
        if is_cleaned:
            _clean(copy, table)
        copy.modifiers.new("RobIR triangles", "TRIANGULATE")
        copy.data = _evaluated(copy)
        meshes.append(copy.data)
        copy.modifiers.clear()
        copy.parent = None
        copy.data.transform(asset.matrix_world)
        copy.matrix_world = Matrix()
        if size:
            copy.data.transform(Matrix.Scale(size / np.ptp(points_of(copy), axis=0).max(), 4))
        copy.data.transform(Matrix.Translation(-middle_of_foot(copy)))
        yield copy
    finally:
        bpy.data.batch_remove([copy, *meshes])


@contextmanager
def level_of(
    dense: bpy.types.Object, faces: int, side: int, name: str
) -> Iterator[bpy.types.Object]:
    """A coarser copy under a name, whose material has the dense one's shape as a normal map."""
    with reduced(dense, faces, 0):
        data = _evaluated(dense)
    level, data.name = bpy.data.objects.new(name, data), name
    dense.users_collection[0].objects.link(level)
    bumps = bpy.data.images.new(f"{name} normal", side, side)
    bumps.colorspace_settings.name = "Non-Color"
    materials = [m.copy() for m in data.materials if m is not None]
    try:
        own = data.attributes.get("custom_normal")  # of the dense mesh; the map holds them
        if own is not None:
            data.attributes.remove(own)
        data.materials.clear()
        for material in materials:
            data.materials.append(material)
        textures = []
        for nodes in (material.node_tree.nodes for material in materials):
            textures.append(nodes.new("ShaderNodeTexImage"))
            textures[-1].image, nodes.active = bumps, textures[-1]  # the active one is baked into
        _bake(dense, level)
        bumps.pack()
        data.transform(Matrix.Translation((0.0, 0.0, -middle_of_foot(level).z)))
        for material, texture in zip(materials, textures, strict=True):
            nodes, links = material.node_tree.nodes, material.node_tree.links
            tangent = nodes.new("ShaderNodeNormalMap")
            links.new(texture.outputs["Color"], tangent.inputs["Color"])
            for shader in [n for n in nodes if n.type == "BSDF_PRINCIPLED"]:
                links.new(tangent.outputs["Normal"], shader.inputs["Normal"])
        yield level
    finally:
        bpy.data.batch_remove([level, data, *materials, bumps])


def _clean(copy: bpy.types.Object, table: Mapping[str, Any]) -> None:
    with suppress(ResultError):  # there is nothing of it, or nothing else
        if table.get("ground"):
            most = GROUND_SHARE * table["bounds"]["radius"]
            delete_faces(copy, faces_of_ground(copy, table["ground"], most))
    with suppress(ResultError):
        delete_faces(copy, crumbs(copy))


def _evaluated(shown: bpy.types.Object) -> bpy.types.Mesh:
    """A mesh of its own with what the modifiers do."""
    graph = bpy.context.evaluated_depsgraph_get()
    return bpy.data.meshes.new_from_object(
        shown.evaluated_get(graph), preserve_all_data_layers=True, depsgraph=graph
    )


def _bake(dense: bpy.types.Object, level: bpy.types.Object) -> None:
    scene, layer = bpy.context.scene, bpy.context.view_layer
    engine, samples = scene.render.engine, scene.cycles.samples
    scene.render.engine, scene.cycles.samples = "CYCLES", 1
    areas = [face.area for face in level.data.polygons]
    try:
        with only_selected(layer, [dense, level], level):
            bpy.ops.object.bake(
                type="NORMAL",
                use_selected_to_active=True,
                cage_extrusion=_CAGE * (sum(areas) / len(areas)) ** 0.5,
                margin=_MARGIN,
                use_clear=True,
            )
    except RuntimeError as fault:
        raise ResultError("the normal map cannot be baked ({fault})", fault=fault) from fault
    finally:
        scene.render.engine, scene.cycles.samples = engine, samples


@contextmanager
def reduced(asset: bpy.types.Object, faces: int, side: int) -> Iterator[None]:
    """Give the object at most so many faces, textures such a side (0: any), and take it back."""
    before = len(asset.data.polygons)
    modifier = None
    if 0 < faces < before:
        modifier = asset.modifiers.new("RobIR faces", "DECIMATE")
        modifier.ratio = faces / before
    swapped = _smaller_textures(asset, side) if side else []
    try:
        yield
    finally:
        if modifier is not None:
            asset.modifiers.remove(modifier)
        for node, image in swapped:
            smaller, node.image = node.image, image
            if smaller.users == 0:
                bpy.data.images.remove(smaller)


def _smaller_textures(
    asset: bpy.types.Object, side: int
) -> list[tuple[bpy.types.Node, bpy.types.Image]]:
    """Put smaller copies into the object's materials; the nodes and what they had."""
    swapped = []
    copies: dict[bpy.types.Image, bpy.types.Image] = {}
    for material in {slot.material for slot in asset.material_slots if slot.material}:
        for node in material.node_tree.nodes if material.node_tree else ():
            image = node.image if node.type == "TEX_IMAGE" else None
            if image is None or max(image.size) <= side:
                continue
            if image not in copies:
                share = side / max(image.size)
                copies[image] = image.copy()
                _shrink(copies[image], [max(1, round(share * pixels)) for pixels in image.size])
                copies[image].pack()
            node.image = copies[image]
            swapped.append((node, image))
    return swapped


def _shrink(image: bpy.types.Image, size: list[int]) -> None:
    """Scale an image, every tile of it; Blender 4.2 can scale the first only, so none."""
    if image.source != "TILED":
        image.scale(*size)
    elif "tile_index" in image.bl_rna.functions["scale"].parameters:
        for index in range(len(image.tiles)):
            image.scale(*size, tile_index=index)
