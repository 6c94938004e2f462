# SPDX-License-Identifier: GPL-3.0-or-later
"""A result in its real size and place, and the parts of its mesh that are not wanted.

The object's mesh is moved and scaled itself, so that its scale stays 1 and its origin lies at its
foot. What was done is remembered on the object, and done again to a newer mesh. The cameras of the
photographs and the lamps go along.
"""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import Any

import bmesh
import bpy
import numpy as np
from mathutils import Matrix, Vector

from ..blocks import MARK, numbers_of, with_mark
from ..engine.errors import ResultError
from ..relighting.lights import scale_lamp

# custom property of the object: scale and shift (3) of its mesh against the capture's frame
_FITTED = "robir_fitted"
# custom property of the object: scale and shift (3) of cameras and lamps, world
_MOVED = "robir_moved"
# custom property of the object: it was stood on the floor, and is again where its foot goes
_STANDS = "robir_stands"
# custom property of the object: the height up to which its ground was deleted, capture's unit
_DROPPED = "robir_dropped"
SPOT = "robir_spot"  # custom property of a dot that goes with the object's mesh
_SAME = (1.0, 0.0, 0.0, 0.0)

# share of the object's faces below which a part that hangs on nothing is no part of it
_CRUMB = 0.005
_STEEP = 0.1  # cosine below which a plane carries nothing

# height above the ground, in radii of the object's bounds, up to which faces belong to it
GROUND_SHARE = 0.03


def scale_result(asset: bpy.types.Object, factor: float) -> None:
    """Make the object, its cameras and lamps so many times as large, about the object's origin."""
    _fit(asset, factor, Vector())
    origin = asset.matrix_world.translation
    _move_others(asset, factor, origin - factor * origin)


def stand(asset: bpy.types.Object, ground: Mapping[str, Any] | None = None) -> None:
    """Put the object's origin to its foot, the middle of its bounds' lower side, and that to 0.

    Where it still has the ground that it stands on, that is the foot, whatever hangs below.
    """
    foot = middle_of_foot(asset, ground)
    _fit(asset, 1.0, -(asset.matrix_world.inverted() @ foot))
    _move_others(asset, 1.0, -foot)
    placed = asset.matrix_world.copy()
    placed.translation = (0.0, 0.0, 0.0)
    asset.matrix_world = placed
    asset[_STANDS] = True


def middle_of_foot(asset: bpy.types.Object, ground: Mapping[str, Any] | None = None) -> Vector:
    """Middle of the lower side of the object's bounds, or the ground below it (`stand`); world."""
    # the bounds that Blender keeps are those of before a deletion
    points = points_of(asset) @ np.array(asset.matrix_world.to_3x3()).T
    low, high = points.min(axis=0), points.max(axis=0)
    foot = asset.matrix_world.translation + Vector((*(0.5 * (low + high))[:2], low[2]))
    if ground is None:
        return foot
    with suppress(ResultError):  # it is edited too far to tell
        if faces_of_ground(asset, ground, 0.0).any():
            scale, *shift = asset.get(_FITTED, _SAME)
            normal = Vector(ground["normal"])
            on_it = asset.matrix_world @ (scale * ground["offset"] * normal + Vector(shift))
            up = asset.matrix_world.to_3x3().inverted().transposed() @ normal
            if up.z > _STEEP * up.length:
                foot.z = on_it.z + up.to_2d() @ (on_it - foot).to_2d() / up.z
    return foot


def drop_ground(asset: bpy.types.Object, ground: Mapping[str, Any], most: float) -> None:
    """Delete ground up to a height, capture frame, and what then hangs on nothing; stand again."""
    delete_faces(asset, faces_of_ground(asset, ground, most))
    with suppress(ResultError):  # there are none
        delete_faces(asset, crumbs(asset))
    asset[_DROPPED] = most
    if asset.get(_STANDS):
        stand(asset)


def drop_again(asset: bpy.types.Object, ground: Mapping[str, Any] | None) -> None:
    """Take the ground off a newer mesh, if that was done to the one before."""
    if ground is not None and _DROPPED in asset:
        with suppress(ResultError):  # the newer one has no such ground
            drop_ground(asset, ground, asset[_DROPPED])


def fit_again(asset: bpy.types.Object, data: bpy.types.Mesh) -> None:
    """Do to a newer mesh, in the capture's frame, what was done to the object's before."""
    scale, *shift = asset.get(_FITTED, _SAME)
    data.transform(Matrix.Translation(shift) @ Matrix.Scale(scale, 4))


def move_again(asset: bpy.types.Object, others: Sequence[bpy.types.Object]) -> None:
    """Take cameras and lamps that were made anew to where those before had been taken."""
    scale, *shift = asset.get(_MOVED, _SAME)
    _move(others, scale, Vector(shift))


def faces_of_ground(asset: bpy.types.Object, ground: Mapping[str, Any], most: float) -> np.ndarray:
    """Faces (F,) that reach at most so high above a plane; capture frame and unit."""
    scale, *shift = asset.get(_FITTED, _SAME)
    height = ((_corners(asset) - shift) / scale) @ np.asarray(ground["normal"])
    height -= ground["offset"]
    return (height <= most).all(axis=1)


def faces_outside(asset: bpy.types.Object, box: bpy.types.Object) -> np.ndarray:
    """Faces (F,) whose middle is outside the size of an empty or the bounds of a mesh."""
    if box.type == "EMPTY":
        low, high = np.full(3, -box.empty_display_size), np.full(3, box.empty_display_size)
    else:
        corners = np.array(box.bound_box)
        low, high = corners.min(axis=0), corners.max(axis=0)
    into = np.array(box.matrix_world.inverted() @ asset.matrix_world)
    middle = _corners(asset).mean(axis=1) @ into[:3, :3].T + into[:3, 3]
    return ((middle < low) | (middle > high)).any(axis=1)


def delete_faces(asset: bpy.types.Object, chosen: np.ndarray) -> None:
    """Delete some faces of the object, and the vertices that only these had."""
    if not chosen.any():
        raise ResultError("there is nothing of the object to delete")
    if chosen.all():
        raise ResultError("nothing would be left of the object; nothing was deleted")
    mesh = bmesh.new()
    try:
        mesh.from_mesh(asset.data)
        mesh.faces.ensure_lookup_table()
        wanted = [mesh.faces[int(index)] for index in np.flatnonzero(chosen)]
        bmesh.ops.delete(mesh, geom=wanted, context="FACES")
        mesh.to_mesh(asset.data)
    finally:
        mesh.free()
    asset.data.update()


def crumbs(asset: bpy.types.Object) -> np.ndarray:
    """Which faces belong to parts of few faces that touch no other part, (F,) bool."""
    corners = _corners(asset).astype(np.float32)  # seams of the texture part vertices, not places
    _, place = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)
    place = place.reshape(-1, 3)
    part = np.arange(place.max() + 1)
    while True:  # each place takes the lowest number that it reaches, and that one's again
        before, lowest = part.copy(), part[place].min(axis=1)
        for corner in place.T:
            np.minimum.at(part, corner, lowest)
        part = part[part]
        if (part == before).all():
            break
    of_face = part[place[:, 0]]
    return np.bincount(of_face)[of_face] < _CRUMB * len(place)


def points_of(asset: bpy.types.Object) -> np.ndarray:
    """(V, 3) vertices, object frame."""
    return numbers_of(asset.data.vertices, "co", 3)


def _corners(asset: bpy.types.Object) -> np.ndarray:
    """(F, 3, 3) corners of the triangles, object frame."""
    data = asset.data
    data.calc_loop_triangles()
    if len(data.loop_triangles) != len(data.polygons):
        raise ResultError("the object has faces that are no triangles; it was edited too far")
    index = numbers_of(data.loops, "vertex_index", kind=np.int32)
    return points_of(asset)[index.reshape(-1, 3)].astype(np.float64)


def _fit(asset: bpy.types.Object, factor: float, shift: Vector) -> None:
    """Scale and shift the mesh in the object's frame, and remember it."""
    asset.data.transform(Matrix.Translation(shift) @ Matrix.Scale(factor, 4), shape_keys=True)
    asset.data.update()
    for dot in (child for child in asset.children if SPOT in child):
        dot.location = factor * dot.location + shift
        dot.empty_display_size *= factor
    asset[_FITTED] = _after(asset.get(_FITTED, _SAME), factor, shift)


def _move_others(asset: bpy.types.Object, factor: float, shift: Vector) -> None:
    others = [o for o in with_mark(bpy.data.objects, asset[MARK]) if o.type in ("CAMERA", "LIGHT")]
    _move(others, factor, shift)
    asset[_MOVED] = _after(asset.get(_MOVED, _SAME), factor, shift)


def _move(others: Sequence[bpy.types.Object], factor: float, shift: Vector) -> None:
    for other in others:
        if other.parent is None:  # what hangs on something else goes with that
            other.location = factor * other.location + shift
            if other.type == "LIGHT":
                scale_lamp(other, factor)
            if other.type == "CAMERA":
                for name in ("display_size", "clip_start", "clip_end"):
                    setattr(other.data, name, factor * getattr(other.data, name))


def _after(before: Sequence[float], factor: float, shift: Vector) -> list[float]:
    """Scale and shift of one similarity after another."""
    scale, *first = before
    return [factor * scale, *(factor * one + two for one, two in zip(first, shift, strict=True))]
