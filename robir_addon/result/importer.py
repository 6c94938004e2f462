# SPDX-License-Identifier: GPL-3.0-or-later
"""Brings a result folder into the open Blender file.

One collection holds it all: the object with its Principled material, the capture's cameras with
their photographs behind, and the recovered sun as a lamp. The recovered light becomes the scene's
World; the World it had before is remembered. Importing the same folder again replaces mesh and
pictures, cameras and lamps; what the user made, or made of the object and its light, is kept.
"""

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from mathutils import Vector

from ..blocks import MARK, are_there, remove_marked, select_alone, viewports, with_mark
from ..capture.cameras import VIEW, add_camera, use_camera
from ..capture.viewport import frame, put_aside
from ..engine.errors import ResultError
from ..gateway import CAMERA, NUMBERS, JobPaths, file_in, leads_out, read_record, special_fault
from ..relighting.lights import (
    add_lamps,
    give_back_world,
    lamps_of,
    light_lamps,
    make_world,
    refresh_world,
    show_recovered_light,
    shows_recovered_light,
    turn_light,
    world_of,
)
from ..relighting.rendering import view_name, view_transform_differs
from ..words import told
from .compositing import hide_few_views
from .glb import GlbMesh, read_glb
from .materials import add_asset, mark_as_imported, refresh_asset, texture_sockets
from .placing import drop_again, move_again

_ROLE = "robir_role"

_CAMERAS = {
    "views": [CAMERA | {"image": str}],
    "bounds": {"centre": NUMBERS, "radius": float},
    "ground?": {"normal": NUMBERS, "offset": float},
}
_LAMP = {
    "irradiance": NUMBERS,
    "direction": NUMBERS,
    "angular_diameter": float,
    "distance?": float,
}
_LIGHT = {"sun_lamps": [_LAMP]}
_TONE_CURVE = {
    "family": str,
    "exposure": float,
    "blender_view_transform": (None, str),
    "blender_gamma?": float,
}
_RUN = {"device": str, "seed": int}


@dataclass(frozen=True)
class Imported:
    """What an import made: the light's suns are hidden where the environment holds them."""

    asset: bpy.types.Object
    cameras: dict[str, bpy.types.Object]
    lamps: list[bpy.types.Object]
    world: bpy.types.World


def mark_of(root: Path) -> str:
    """What the data-blocks of a result folder are marked with."""
    return os.path.normpath(root.absolute())  # no look at the disk: polls ask for it


def import_result(root: Path, scene: bpy.types.Scene, *, use_sun_lamp: bool = True) -> Imported:
    """Import a finished result folder; view transform and camera of the scene stay as they are.

    A recovered sun is a lamp, or part of the environment. After an error nothing has changed. Of a
    result that is there, what the worker made is replaced: the object keeps its name, place,
    modifiers, collections and material, the scene its camera and light, however that is turned.
    """
    paths, table, suns = _opened(root)
    mark, name, views = mark_of(root), paths.root.name, table["views"]
    mesh = read_glb(paths.asset)
    asset, world = asset_of(root), world_of(mark)
    is_new = asset is None or world is None
    were_lit, chosen = any(not lamp.hide_render for lamp in lamps_of(mark)), None
    if scene.camera is not None and scene.camera.get(MARK) == mark:
        chosen = scene.camera.get(VIEW)
    if is_new:
        _remove_objects(mark)
        asset = add_asset(mesh, name, paths, mark)
    else:
        _refresh(asset, world, mesh, paths, table)
    collection = _collection(name, "result", mark, scene.collection)
    stands = _collection(f"{name} cameras", "cameras", mark, collection)
    lamps = _add_lamps(suns, paths, table["bounds"], collection)
    cameras = _add_cameras(paths, table, stands)
    if is_new:
        collection.objects.link(asset)
        world = make_world(name, paths, mark)
        show_recovered_light(scene, world, use_sun_lamp)
        turn_light(scene, 0.0)
        if scene.camera is None:
            first = next((v["name"] for v in views if v["split"] == "held_out"), views[0]["name"])
            use_camera(scene, cameras[first])
        return Imported(asset, cameras, lamps, world)
    move_again(asset, [*cameras.values(), *lamps])
    if chosen in cameras:
        scene.camera = cameras[chosen]
    if scene.world == world and shows_recovered_light(world):
        show_recovered_light(scene, world, use_sun_lamp)
    else:
        light_lamps(scene, mark, were_lit)
    return Imported(asset, cameras, lamps, world)


def _opened(root: Path) -> tuple[JobPaths, dict[str, Any], list[dict[str, Any]]]:
    """Names of a whole result's files, its cameras and suns."""
    paths = JobPaths(Path(mark_of(root)))
    if fault := special_fault(paths.root):  # Blender would wait for ever where it opens a pipe
        raise ResultError(fault)
    table, suns = read_cameras(paths), _read(paths.light, _LIGHT)["sun_lamps"]
    for file in (paths.environment, *(file for file, _, _ in texture_sockets(paths))):
        if not are_there(file):
            raise ResultError("{file} is missing; export the result again", file=file)
    return paths, table, suns


def import_light(root: Path, scene: bpy.types.Scene, *, use_sun_lamp: bool) -> None:
    """Bring the recovered light of a finished result folder into a scene, without its object."""
    paths, table, suns = _opened(root)
    mark = mark_of(root)
    bpy.data.batch_remove(lamps_of(mark))
    world = world_of(mark)
    if world is None:
        world = make_world(paths.root.name, paths, mark)
    else:
        refresh_world(world, paths)
    collection = _collection(paths.root.name, "result", mark, scene.collection)
    _add_lamps(suns, paths, table["bounds"], collection)
    show_recovered_light(scene, world, use_sun_lamp)
    turn_light(scene, scene.robir.rotation)


def _refresh(
    asset: bpy.types.Object,
    world: bpy.types.World,
    mesh: GlbMesh,
    paths: JobPaths,
    table: dict[str, Any],
) -> None:
    """Replace mesh, pictures and light that are there; take cameras and lamps out."""
    mark = asset[MARK]
    hide_few_views(mark)
    refresh_asset(asset, mesh, paths)
    drop_again(asset, table.get("ground"))
    mark_as_imported(asset)
    refresh_world(world, paths)
    others = [o for o in with_mark(bpy.data.objects, mark) if o.type in ("CAMERA", "LIGHT")]
    bpy.data.batch_remove(others)
    remove_marked(mark, bpy.data.cameras, bpy.data.lights)
    bpy.data.batch_remove([i for i in with_mark(bpy.data.images, mark) if not i.users])


def _add_lamps(
    suns: list[dict[str, Any]],
    paths: JobPaths,
    bounds: dict[str, Any],
    collection: bpy.types.Collection,
) -> list[bpy.types.Object]:
    lamps = add_lamps(suns, paths.root.name, mark_of(paths.root))
    for lamp, sun in zip(lamps, suns, strict=True):
        # a Sun shines from everywhere along its direction; its place is for the eye
        away = sun.get("distance", 1.5 * bounds["radius"])
        towards = lamp.rotation_quaternion.to_matrix().col[2]
        lamp.location = [c + away * t for c, t in zip(bounds["centre"], towards, strict=True)]
        collection.objects.link(lamp)
    return lamps


def _add_cameras(
    paths: JobPaths, table: dict[str, Any], stands: bpy.types.Collection
) -> dict[str, bpy.types.Object]:
    centre = table["bounds"]["centre"]
    cameras = {v["name"]: add_camera(v, paths.cameras.parent, centre) for v in table["views"]}
    for camera in cameras.values():
        for block in (camera, camera.data, camera.data.background_images[0].image):
            block[MARK] = mark_of(paths.root)
        stands.objects.link(camera)
    return cameras


def remove_result(root: Path) -> None:
    """Take an imported result out of the file; its scenes get their own World back."""
    mark = mark_of(root)
    for scene in bpy.data.scenes:
        if scene.world is not None and scene.world.get(MARK) == mark:
            give_back_world(scene)
    _remove_objects(mark)
    for collection in with_mark(bpy.data.collections, mark):
        _release(collection)
    remove_marked(mark, bpy.data.collections, bpy.data.worlds, bpy.data.images)


def asset_of(root: Path) -> bpy.types.Object | None:
    """The object of an imported result, if it is in the file."""
    return next((o for o in with_mark(bpy.data.objects, mark_of(root)) if o.type == "MESH"), None)


def imported_objects() -> list[bpy.types.Object]:
    """The objects of all results that are in the file and in one of its scenes."""
    return [o for o in bpy.data.objects if o.type == "MESH" and MARK in o and o.users_scene]


def active_result(context: bpy.types.Context) -> str:
    """Folder of the imported result that the active object belongs to; empty if to none."""
    active = context.view_layer.objects.active if context.view_layer else None
    mark = active.get(MARK) if active is not None else None
    return mark if isinstance(mark, str) and asset_of(Path(mark)) is not None else ""


def read_cameras(paths: JobPaths) -> dict[str, Any]:
    """Contents of cameras.json: "views" with fit names and pictures, "bounds", "ground" if any."""
    table = _read(paths.cameras, _CAMERAS)
    for view in table["views"]:
        try:
            file_in(paths.renders, view["name"])
            is_strange = leads_out(paths.cameras.parent / view["image"], [paths.root])
        except ValueError as fault:
            raise ResultError(
                "{file} holds a view that cannot be: {fault}", file=paths.cameras, fault=fault
            ) from fault
        if is_strange or min(view[key] for key in ("width", "height", "fx", "fy")) <= 0:
            raise ResultError(
                "{file}: the view {name!a} cannot be", file=paths.cameras, name=view["name"]
            )
    if not table["views"]:
        raise ResultError("{file} holds no views; export the result again", file=paths.cameras)
    return table


def read_tone_curve(paths: JobPaths) -> dict[str, Any]:
    """Contents of tone_curve.json, as far as Blender is concerned."""
    return {"blender_gamma": 1.0} | _read(paths.tone_curve, _TONE_CURVE)


def read_run(paths: JobPaths) -> dict[str, Any]:
    """Contents of run.json, as far as an asset is concerned."""
    return _read(paths.run, _RUN)


def _read(path: Path, form: dict[str, Any]) -> dict[str, Any]:
    """Contents of one of the result folder's JSON files; damage is a ResultError."""
    try:
        return read_record(path, form)
    except (OSError, ValueError) as fault:
        text = "{file} cannot be read ({fault}); choose a folder that `robir reconstruct` finished"
        raise ResultError(text, file=path, fault=fault) from fault


def _remove_objects(mark: str) -> None:
    """Remove what an earlier import made, but for the collection and the World."""
    hide_few_views(mark)
    data = bpy.data
    kinds = (data.objects, data.meshes, data.cameras, data.lights, data.materials, data.images)
    remove_marked(mark, *kinds)


def _collection(
    name: str, role: str, mark: str, parent: bpy.types.Collection
) -> bpy.types.Collection:
    """A collection of the result's; one that the user moved within its parent stays there."""
    known = [c for c in with_mark(bpy.data.collections, mark) if c.get(_ROLE) == role]
    collection = known[0] if known else bpy.data.collections.new(name)
    collection[MARK], collection[_ROLE] = mark, role
    if collection not in parent.children_recursive:
        parent.children.link(collection)
    return collection


def _release(collection: bpy.types.Collection) -> None:
    """Hand what the user put into a collection to the scenes that showed it."""
    for scene in bpy.data.scenes:
        if collection not in scene.collection.children_recursive:
            continue
        home = scene.collection
        for foreign in collection.objects:
            if foreign.name not in home.objects:
                home.objects.link(foreign)
        for child in collection.children:
            if MARK not in child and child.name not in home.children:
                home.children.link(child)


def bring_in(context: bpy.types.Context, root: Path) -> list[str]:
    """Import a result and show it; a new one is selected and framed. What to tell the user."""
    scene = context.scene
    settings = scene.robir
    curve = read_tone_curve(JobPaths(root))
    is_new = asset_of(root) is None
    imported = import_result(root, scene, use_sun_lamp=settings.use_sun_lamp)
    settings.result = str(root)
    if not is_new:
        turn_light(scene, settings.rotation)
        text = "{name} is as the newer result has it; what you did is kept"
        return [told(text, name=imported.asset.name)]
    settings.rotation = 0.0
    context.view_layer.update()  # else Blender 5 lists objects that are gone
    select_alone(context.view_layer, imported.asset)
    hidden = put_aside(scene, context.view_layer)
    corners = [imported.asset.matrix_world @ Vector(c) for c in imported.asset.bound_box]
    centre = Vector(np.mean(corners, axis=0))
    frame(scene, centre, max((corner - centre).length for corner in corners))
    light_up(context)
    name, count = imported.asset.name, len(imported.cameras)
    notes = [told("Imported {name} with {count} cameras", name=name, count=count)]
    if view_transform_differs(scene, curve):
        notes.append(
            told(
                "The photographs were made through {made}, the scene is shown through {shown}; "
                "Match View Transform makes them alike",
                made=view_name(curve),
                shown=scene.view_settings.view_transform,
            )
        )
    if hidden:
        notes.append(told("Blender's own objects are hidden: {names}", names=", ".join(hidden)))
    others = [
        o.name for o in scene.objects if o.type == "LIGHT" and MARK not in o and not o.hide_render
    ]
    if others:
        text = "The scene's own lights shine on the object too: {names}"
        notes.append(told(text, names=", ".join(others)))
    return notes


def light_up(context: bpy.types.Context) -> None:
    """Show the viewports of the scene lit by what the scene holds."""
    for area in viewports(context.scene):
        shading = area.spaces.active.shading
        if shading.type in ("WIREFRAME", "SOLID"):  # these show neither material nor light
            shading.type = "MATERIAL"
        shading.use_scene_world = shading.use_scene_lights = True
