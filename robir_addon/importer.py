# SPDX-License-Identifier: GPL-3.0-or-later
"""Brings a result folder into the open Blender file.

One collection holds it all: the object with its Principled material, and the capture's cameras with
their photographs behind. The scene gets the recovered light as its World and the recovered tone
curve as its view transform. Importing the same folder again replaces what the first time made.
"""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from .cameras import add_camera, use_camera
from .errors import ResultError
from .gateway import JobPaths
from .glb import GlbMesh, read_glb

MARK = "robir_result"
"""Custom property that names the result folder a data-block came from."""


@dataclass(frozen=True)
class Imported:
    """What an import made.

    Attributes:
        collection: Holds the object and the cameras.
        asset: The reconstructed object.
        cameras: One camera object a view, by the view's name.
        world: The recovered light.
        notes: Sentences for the user, for example on a tone curve Blender does not have.
    """

    collection: bpy.types.Collection
    asset: bpy.types.Object
    cameras: dict[str, bpy.types.Object]
    world: bpy.types.World
    notes: tuple[str, ...]


def import_result(root: Path, scene: bpy.types.Scene) -> Imported:
    """Import a finished result folder.

    Args:
        root: The result folder, OUT of `robir reconstruct`.
        scene: Scene to put it into.

    Returns:
        What was made.

    Raises:
        ResultError: If the folder holds no finished export.
    """
    root = root.resolve()
    paths = JobPaths(root)
    table = read_json(paths.cameras)
    views, centre = table["views"], table["bounds"]["centre"]
    tone_curve = read_json(paths.tone_curve)
    mesh = read_glb(paths.asset)
    if not paths.environment.is_file():
        raise ResultError(f"{paths.environment} is missing; export the result again")
    mark = str(root)
    remove_result(mark)
    name = root.name
    collection = bpy.data.collections.new(name)
    collection[MARK] = mark
    scene.collection.children.link(collection)
    asset = _add_object(mesh, _material(name, paths, mark), mark)
    collection.objects.link(asset)
    cameras = {}
    for view in views:
        camera = add_camera(view, paths.cameras.parent, centre)
        for block in (camera, camera.data, camera.data.background_images[0].image):
            block[MARK] = mark
        collection.objects.link(camera)
        cameras[view["name"]] = camera
    world = _world(name, paths.environment, mark)
    scene.world = world
    first = next((v["name"] for v in views if v["split"] == "held_out"), views[0]["name"])
    use_camera(scene, cameras[first])
    return Imported(collection, asset, cameras, world, _set_view_transform(scene, tone_curve))


def remove_result(mark: str) -> None:
    """Remove every data-block that an earlier import of the same folder made."""
    kinds = (
        bpy.data.objects,
        bpy.data.collections,
        bpy.data.meshes,
        bpy.data.cameras,
        bpy.data.materials,
        bpy.data.worlds,
        bpy.data.images,
    )
    for blocks in kinds:
        for block in [b for b in blocks if b.get(MARK) == mark]:
            blocks.remove(block)


def read_json(path: Path) -> dict[str, Any]:
    """Contents of one of the result folder's JSON files; damage is a ResultError."""
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as fault:
        raise ResultError(
            f"{path} cannot be read ({fault}); choose a folder that `robir reconstruct` finished"
        ) from fault


def _add_object(mesh: GlbMesh, material: bpy.types.Material, mark: str) -> bpy.types.Object:
    data = bpy.data.meshes.new(mesh.name)
    data[MARK] = mark
    data.from_pydata(mesh.vertices.tolist(), [], mesh.faces.tolist())
    layer = data.uv_layers.new(name="UVMap")
    layer.uv.foreach_set("vector", mesh.corner_uvs.reshape(-1).astype(np.float32))
    data.polygons.foreach_set("use_smooth", np.ones(len(mesh.faces), dtype=bool))
    data.normals_split_custom_set(mesh.corner_normals.reshape(-1, 3).tolist())
    data.materials.append(material)
    data.update()
    asset = bpy.data.objects.new(mesh.name, data)
    asset[MARK] = mark
    return asset


def _material(name: str, paths: JobPaths, mark: str) -> bpy.types.Material:
    """Principled material from the texture files; IOR stays Blender's 1.5."""
    material = bpy.data.materials.new(name)
    material[MARK] = mark
    _enable_nodes(material)
    nodes, links = material.node_tree.nodes, material.node_tree.links
    shader = next(node for node in nodes if node.type == "BSDF_PRINCIPLED")
    sockets = [("albedo.png", "Base Color", "sRGB"), ("roughness.png", "Roughness", "Non-Color")]
    if (paths.textures / "metallic.png").is_file():
        sockets.append(("metallic.png", "Metallic", "Non-Color"))
    for row, (file, socket, space) in enumerate(sockets):
        texture = nodes.new("ShaderNodeTexImage")
        texture.location = (-420, 300 - 300 * row)
        texture.label = socket
        texture.image = _image(paths.textures / file, space, mark)
        links.new(texture.outputs["Color"], shader.inputs[socket])
    return material


def _world(name: str, environment: Path, mark: str) -> bpy.types.World:
    """World whose background is the recovered light; the mapping node turns it."""
    world = bpy.data.worlds.new(name)
    world[MARK] = mark
    _enable_nodes(world)
    nodes, links = world.node_tree.nodes, world.node_tree.links
    nodes.clear()
    place = nodes.new("ShaderNodeTexCoord")
    turn = nodes.new("ShaderNodeMapping")
    picture = nodes.new("ShaderNodeTexEnvironment")
    background = nodes.new("ShaderNodeBackground")
    output = nodes.new("ShaderNodeOutputWorld")
    for column, node in enumerate((place, turn, picture, background, output)):
        node.location = (220 * column - 800, 0)
    picture.image = _image(environment, "Linear Rec.709", mark)
    links.new(place.outputs["Generated"], turn.inputs["Vector"])
    links.new(turn.outputs["Vector"], picture.inputs["Vector"])
    links.new(picture.outputs["Color"], background.inputs["Color"])
    links.new(background.outputs["Background"], output.inputs["Surface"])
    return world


def set_environment(world: bpy.types.World, file: Path, rotation: float) -> None:
    """Light the scene with another lat-long image.

    Args:
        world: One that the importer made.
        file: .exr or .hdr, linear Rec.709.
        rotation: Radians about the up axis, counter-clockwise seen from above.
    """
    nodes = world.node_tree.nodes
    picture = next(node for node in nodes if node.type == "TEX_ENVIRONMENT")
    turn = next(node for node in nodes if node.type == "MAPPING")
    picture.image = _image(file, "Linear Rec.709", world.get(MARK, ""))
    # the mapping turns the direction that is looked up, so the picture turns the other way
    turn.inputs["Rotation"].default_value = (0.0, 0.0, -rotation)


def _image(file: Path, space: str, mark: str) -> bpy.types.Image:
    try:
        image = bpy.data.images.load(str(file), check_existing=False)
    except RuntimeError as fault:
        raise ResultError(f"{file} cannot be read as an image; is it there and whole?") from fault
    image.colorspace_settings.name = space
    image[MARK] = mark
    return image


def _set_view_transform(scene: bpy.types.Scene, tone_curve: dict[str, Any]) -> tuple[str, ...]:
    """Show the scene as the photographs do; says so where Blender has no such curve."""
    wanted = tone_curve["blender_view_transform"]
    settings = scene.view_settings
    settings.look = "None"
    settings.gamma = 1.0
    settings.exposure = tone_curve["exposure"]
    settings.view_transform = wanted or "Standard"
    if wanted:
        return ()
    return (
        f"the recovered tone curve ({tone_curve['family']}) is none of Blender's view transforms: "
        "the viewport shows Standard; rendered files go through export/tone_curve.cube",
    )


def _enable_nodes(block: bpy.types.Material | bpy.types.World) -> None:
    if bpy.app.version < (5, 0, 0):  # later versions always have nodes and warn about the flag
        block.use_nodes = True
