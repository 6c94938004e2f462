# SPDX-License-Identifier: GPL-3.0-or-later
"""What the user knows and photographs leave open: a spot's paint, the sun, the tone curve."""

import json
import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from mathutils import Vector
from mathutils.geometry import barycentric_transform, closest_point_on_tri

from ..blocks import numbers_of
from ..engine.errors import RequestError, ResultError
from ..gateway import JobPaths, client, read_record, read_regular
from ..words import told
from .delight import has_own_layout, target_of
from .importer import asset_of, mark_of
from .placing import SPOT

FAR = 0.05  # farthest that a point may lie from the surface, shares of the object's longest side
_MOST = 10.0, 100.0  # what u and v may be over UDIM tiles
_OUTSIDE = 1e-4  # how far rounding may lead out of the texture


def textured_object(root: Path) -> bpy.types.Object:
    """The object that shows a result's textures: the imported one, or the user's own."""
    shown = asset_of(root)
    if shown is None:
        target = target_of(root)
        shown = target if target is not None and has_own_layout(root) else None
    if shown is None:
        raise ResultError("the object is not in this file; import the result again")
    return shown


def texel_at(shown: bpy.types.Object, place: Sequence[float]) -> tuple[float, float]:
    """Texture coordinates, v upwards, of the point of an object nearest to a place, world."""
    if not shown.visible_get():
        raise _without_surface(shown)
    graph = bpy.context.evaluated_depsgraph_get()
    place, world = Vector(place), shown.matrix_world
    try:
        is_found, nearest, _, face = shown.closest_point_on_mesh(
            world.inverted_safe() @ place, depsgraph=graph
        )
    except RuntimeError as fault:  # it is hidden, or has no faces
        raise _without_surface(shown) from fault
    if not is_found:
        raise _without_surface(shown)
    seen = shown.evaluated_get(graph)
    if (world @ nearest - place).length > FAR * max(seen.dimensions):
        text = "the 3D cursor is not on {name}; put it there with Shift and the right mouse button"
        raise RequestError(text, name=shown.name)
    mesh = seen.to_mesh()  # its data may be that of before a subdivision by the graphics card
    try:
        layer = next((layer for layer in mesh.uv_layers if layer.active_render), None)
        uv = None if layer is None else _interpolated(mesh, layer, face, nearest)
    finally:
        seen.to_mesh_clear()
    if uv is None or not all(
        -_OUTSIDE <= x <= most + _OUTSIDE for x, most in zip(uv, _MOST, strict=True)
    ):
        raise RequestError(
            "{name} lacks the texture coordinates of the result there; undo what removed them",
            name=shown.name,
        )
    return min(max(uv.x, 0.0), _MOST[0]), min(max(uv.y, 0.0), _MOST[1])


def show_spot(shown: bpy.types.Object, place: Sequence[float]) -> None:
    """Show a dot at a place of an object, world; it goes with the object."""
    hide_spots()
    dot = bpy.data.objects.new("RobIR spot", None)
    dot[SPOT] = True
    dot.empty_display_type, dot.empty_display_size = "SPHERE", 0.01 * max(shown.dimensions)
    dot.show_in_front, dot.hide_select = True, True
    dot.parent = shown
    dot.location = shown.matrix_world.inverted_safe() @ Vector(place)
    shown.users_collection[0].objects.link(dot)


def hide_spots() -> None:
    """Take the dots away."""
    bpy.data.batch_remove([o for o in bpy.data.objects if SPOT in o])


def _without_surface(shown: bpy.types.Object) -> RequestError:
    return RequestError("{name} shows no surface; unhide it", name=shown.name)


def _interpolated(
    mesh: bpy.types.Mesh, layer: bpy.types.MeshUVLoopLayer, face: int, point: Vector
) -> Vector:
    """Texture coordinates (2,) of a point, object frame, on one of a mesh's faces."""
    mesh.calc_loop_triangles()
    owners = numbers_of(mesh.loop_triangles, "polygon_index", kind=np.int32).ravel()

    def corners(index: int) -> list[Vector]:
        return [mesh.vertices[vertex].co for vertex in mesh.loop_triangles[index].vertices]

    def distance(index: int) -> float:
        return (closest_point_on_tri(point, *corners(index)) - point).length

    nearest = min(np.flatnonzero(owners == face).tolist(), key=distance)
    uvs = [layer.uv[loop].vector.to_3d() for loop in mesh.loop_triangles[nearest].loops]
    return barycentric_transform(point, *corners(nearest), *uvs).to_2d()


def sun_direction(lamp: bpy.types.Object, shown: bpy.types.Object | None) -> Vector:
    """Direction from the captured object towards the sun that a Sun lamp stands for.

    The capture's own frame is that of the imported object: where the user has turned it, the lamp
    is taken to shine on it as it stands now. Scale and shift of the view turn nothing.
    """
    bpy.context.view_layer.update()  # a script may have turned either just now
    towards = lamp.matrix_world.to_quaternion() @ Vector((0.0, 0.0, 1.0))
    if shown is not None:
        towards = shown.matrix_world.to_3x3().inverted_safe() @ towards
    return towards.normalized()


def shape_of(root: Path) -> str:
    """Fingerprint of a result's shape and so of its texture coordinates; empty if not known."""
    try:
        manifest = read_record(JobPaths(root).manifest("geometry"), {"fingerprint?": str})
    except (OSError, ValueError):
        return ""
    return manifest.get("fingerprint", "")


# longer sides of photographs, pixels, and of textures, texels, by the choice Texture; those of "2K"
# are the engine's defaults
SIDES = {"2K": (800, 2048), "4K": (1600, 4096)}
_MOST_BYTES = 1 << 20  # of a result's settings; they have two thousand
AUTOMATIC = "auto"  # the tone curve that the engine is to find itself
_SPOT = ("spot_texel", "spot_result", "spot_shape")
_DIGITS = 6  # decimals that a property's single precision holds


def size_of(settings: Any) -> tuple[str, ...]:
    """Items of `--set` by which the engine is told of finer textures; none for the usual ones."""
    if settings.texture == "2K":
        return ()
    photograph, texture = SIDES[settings.texture]
    return f"capture.max_side={photograph}", f"appearance.texture_size={texture}"


def known_of(settings: Any) -> tuple[str, ...]:
    """Items of `--set` by which the engine is told what the user knows; none for nothing."""
    items: dict[str, list[Any]] = {}
    if settings.tone_curve != AUTOMATIC:
        items["families"] = [settings.tone_curve]
    if settings.spot_result:
        items["white_point"] = [*settings.spot_texel, *settings.spot_albedo]
    if any(settings.sun):
        items["sun"] = list(settings.sun)
    for name in items.keys() - {"families"}:
        items[name] = [round(value, _DIGITS) for value in items[name]]
    return tuple(f"appearance.{name}={json.dumps(value)}" for name, value in items.items())


def remember_spot(settings: Any, root: Path, texel: tuple[float, float]) -> None:
    """Keep a spot of known paint, v upwards, and which shape's texture it lies on."""
    settings.spot_texel = texel
    settings.spot_result, settings.spot_shape = mark_of(root), shape_of(root)


def forget_spot(settings: Any) -> None:
    """No spot is known any more; the colour stays for the next one."""
    hide_spots()
    for name in _SPOT:
        settings.property_unset(name)


def check_spot(settings: Any, request: client.Request) -> None:
    """Refuse to tell the engine of a spot that would lie elsewhere on the texture of the result."""
    if not settings.spot_result:
        return
    picked = Path(settings.spot_result)
    if mark_of(request.out) != settings.spot_result:
        text = "the spot of known paint was picked on {name}; pick it on this result or forget it"
        raise RequestError(text, name=picked.name)
    # photographs of another size make another shape
    is_alike = _photograph_side_of(picked) == SIDES[settings.texture][0]
    if not is_alike or shape_of(picked) != settings.spot_shape:
        raise RequestError(
            "the spot of known paint lies on another shape than the one this texture size makes; "
            "forget the spot, reconstruct, and pick it again"
        )


def _photograph_side_of(root: Path) -> Any:
    """To which longer side a result reduced its photographs, pixels; None if that is not known."""
    try:
        text = read_regular(JobPaths(root).config, _MOST_BYTES).decode("utf-8")
        return tomllib.loads(text)["capture"]["max_side"]
    except (OSError, ValueError, RecursionError, LookupError, TypeError):
        return None


def forget_former_spot(settings: Any, root: Path) -> list[str]:
    """Forget a spot whose shape a newer result has replaced; a sentence for the user."""
    if settings.spot_result != mark_of(root) or settings.spot_shape == shape_of(root):
        return []
    forget_spot(settings)
    return [told("The shape is another one now: pick the spot of known paint again")]
