# SPDX-License-Identifier: GPL-3.0-or-later
"""A capture in the viewport before anything is computed: cameras, photographs, the object's bounds.

All of it lies in one collection, is known by a mark, and goes together. The cameras hold the files
that the user gave; what hangs in front of them are small copies, so that hundreds of large
photographs neither fill the memory nor stop the window.
"""

import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import bpy
from mathutils import Vector

from ..blocks import viewports
from .cameras import SENSOR_WIDTH, add_camera

COLLECTION = "RobIR capture"
GAP = "coverage-gap"  # code of the finding that a side was not photographed
GAPS = "Not photographed"  # name of the collection that shows it
MARK = "robir_capture"  # custom property of everything that is made here
_LISTED = "robir_size"  # what lists a camera among those of a result, which these are not
_SMALL_SIDE = 128  # longer side of the small copies, pixels
# radii of the object that are shown as they are, and its distance from the origin in radii
_LEAST_RADIUS, _MOST_RADIUS, _MOST_FAR = 0.02, 50.0, 50.0
_TINT = (1.0, 0.25, 0.05, 0.4)
_PATCH = 0.09  # size of a patch of the tint, radii; the check's directions lie 0.16 apart
_MOST_REACH = 12.0  # cameras farther off than this many radii are not made to fit into the view


def show_capture(scene: bpy.types.Scene, facts: dict[str, Any]) -> Iterator[None]:
    """Show what `robir check --json` said of a capture; yields while small copies are left."""
    clear_capture()
    put_aside(scene, scene.view_layers[0])
    facts = _placed_to_view(scene.robir, facts)
    collection = bpy.data.collections.new(COLLECTION)
    collection[MARK] = True
    scene.collection.children.link(collection)
    centre, radius = facts["centre"], facts["radius"]
    seen = "Bounds of the object" if facts["accepted"] else "Where the cameras look"
    bounds = bpy.data.objects.new(seen, None)
    bounds.empty_display_type = "SPHERE"
    bounds.empty_display_size = radius
    bounds.location = centre
    bounds.show_in_front = True
    bounds[MARK] = True
    collection.objects.link(bounds)
    if facts.get("points"):
        collection.objects.link(_sparse_points(facts["points"]))
    for finding in facts.get("findings", ()):
        if finding["code"] == GAP:
            collection.children.link(_gaps(finding["numbers"], centre, radius))
    cameras = []
    for view in facts["cameras"]:
        camera = add_camera(view, Path(), centre)
        del camera[_LISTED]
        for block in (camera, camera.data, camera.data.background_images[0].image):
            block[MARK] = True
        collection.objects.link(camera)
        cameras.append((camera.name, view))
    distances = [
        sum((row[3] - at) ** 2 for row, at in zip(view["camera_to_world"], centre, strict=False))
        for _, view in cameras
    ]
    reach = max(radius, min(max(distances) ** 0.5, _MOST_REACH * radius))
    frame(scene, centre, reach)
    return _hang_photographs(collection.name, cameras)


def _placed_to_view(settings: Any, facts: dict[str, Any]) -> dict[str, Any]:
    """The capture where a viewport shows it well, and in the settings how it was brought there.

    Where its unit makes it so large, so small or so far off that Blender's grid, clipping and
    numbers are of no use, it is shown two units wide above the origin.
    """
    centre, radius = facts["centre"], facts["radius"]
    far = sum(value**2 for value in centre) ** 0.5
    settings.view_scale, settings.view_shift = 1.0, (0.0, 0.0, 0.0)
    if _LEAST_RADIUS < radius < _MOST_RADIUS and far < _MOST_FAR * radius:
        return facts
    scale = settings.view_scale = 1.0 / radius
    settings.view_shift = shift = [a - b * scale for a, b in zip((0, 0, 1), centre, strict=True)]

    def place(point: Sequence[float]) -> list[float]:
        return [scale * value + to for value, to in zip(point, shift, strict=True)]

    views = []
    for view in facts["cameras"]:
        rows = [list(row) for row in view["camera_to_world"]]
        for row, value in zip(rows, place([row[3] for row in rows[:3]]), strict=False):
            row[3] = value
        views.append(view | {"camera_to_world": rows})
    placed = {"centre": place(centre), "radius": 1.0, "cameras": views}
    return facts | placed | {"points": [place(point) for point in facts.get("points", ())]}


def add_box(scene: bpy.types.Scene) -> bpy.types.Object:
    """A box for the user to move about the object, as large as the capture's bounds if shown."""
    box = bpy.data.objects.new("Object box", None)
    box.empty_display_type = "CUBE"
    box.show_in_front = True
    bounds = [o for o in bpy.data.objects if MARK in o and o.empty_display_type == "SPHERE"]
    if bounds:
        box.location = bounds[0].location
        box.empty_display_size = bounds[0].empty_display_size
    scene.collection.objects.link(box)
    return box


def clear_capture() -> None:
    """Take away all that `show_capture` made."""
    kinds = ("objects", "cameras", "images", "meshes", "materials", "collections")
    bpy.data.batch_remove([b for kind in kinds for b in getattr(bpy.data, kind) if MARK in b])


def _sparse_points(points: list[list[float]]) -> bpy.types.Object:
    """Points of the surroundings that were found with the cameras, by which to place the box."""
    mesh = bpy.data.meshes.new("Sparse points")
    mesh.from_pydata(points, [], [])
    shown = bpy.data.objects.new("Sparse points", mesh)
    mesh[MARK] = shown[MARK] = True
    shown.hide_select = shown.hide_render = True
    return shown


def _gaps(numbers: dict[str, Any], centre: Sequence[float], radius: float) -> bpy.types.Collection:
    """Tinted patches of the bounds that no photograph shows, and an arrow at the widest gap."""
    vertices, faces = patches(numbers["missing"], centre, radius)
    mesh, tint = bpy.data.meshes.new(GAPS), bpy.data.materials.new(GAPS)
    mesh.from_pydata(vertices, [], faces)
    tint.diffuse_color = _TINT
    mesh.materials.append(tint)
    arrow = bpy.data.objects.new("Photograph from here", None)
    arrow.empty_display_type, arrow.empty_display_size = "SINGLE_ARROW", 0.6 * radius
    towards = Vector(numbers["gap_direction"])
    arrow.location = Vector(centre) + 1.7 * radius * towards
    arrow.rotation_euler = (-towards).to_track_quat("Z", "Y").to_euler()
    arrow.show_name = True
    collection, shown = bpy.data.collections.new(GAPS), bpy.data.objects.new(GAPS, mesh)
    for block in (shown, arrow):
        block.hide_select = block.hide_render = True
        collection.objects.link(block)
    for block in (collection, mesh, tint, shown, arrow):
        block[MARK] = True
    return collection


def patches(
    directions: Sequence[Sequence[float]], centre: Sequence[float], radius: float
) -> tuple[list[Vector], list[range]]:
    """Corners and faces of hexagons that touch a sphere in directions from its centre."""
    middle, corners = Vector(centre), []
    for towards in map(Vector, directions):
        turned = towards.to_track_quat("Z", "Y")
        for step in range(6):
            turn = step * math.pi / 3.0
            aside = Vector((_PATCH * math.cos(turn), _PATCH * math.sin(turn), 1.0))
            corners.append(middle + radius * (turned @ aside))
    return corners, [range(at, at + 6) for at in range(0, len(corners), 6)]


def _hang_photographs(
    collection_name: str, cameras: list[tuple[str, dict[str, Any]]]
) -> Iterator[None]:
    """Hang a small copy of its photograph in front of each camera, as large as it sees it there."""
    for name, view in cameras:
        yield
        # by name: undo may have taken them away, and then references to them are no more
        camera, collection = bpy.data.objects.get(name), bpy.data.collections.get(collection_name)
        if camera is None or collection is None or MARK not in camera:
            return
        picture = _small_copy(Path(view["image"]), view["name"])
        if picture is None:
            continue
        lens = camera.data
        width = lens.display_size
        height = width * (view["height"] / view["fy"]) / (view["width"] / view["fx"])
        photo = bpy.data.objects.new(f"{view['name']} photograph", None)
        photo[MARK] = True
        photo.empty_display_type = "IMAGE"
        photo.data = picture
        photo.empty_display_size = width if picture.size[0] >= picture.size[1] else height
        photo.parent = camera
        photo.location = (
            lens.shift_x * width,
            lens.shift_y * width,
            -width * lens.lens / SENSOR_WIDTH,
        )
        photo.hide_select = True
        collection.objects.link(photo)


def _small_copy(file: Path, view_name: str) -> bpy.types.Image | None:
    """A photograph reduced to a thumbnail that is kept in the Blender file; None if unreadable."""
    try:
        image = bpy.data.images.load(str(file))
    except RuntimeError:
        return None
    image[MARK] = True
    width, height = image.size
    if not width or not height:
        bpy.data.images.remove(image)
        return None
    shrink = min(1.0, _SMALL_SIDE / max(width, height))
    image.scale(max(1, round(width * shrink)), max(1, round(height * shrink)))
    image.name = small_copy_name(view_name)
    image.pack()
    return image


def small_copy_name(view_name: str) -> str:
    """Name of the small copy of a photograph."""
    return f"{view_name} small"


_ASIDE = "robir_aside"  # custom property of what was hidden here
# type and place of what Blender's startup file holds
_STARTUP = {"Cube": ("MESH", (0.0, 0.0, 0.0)), "Light": ("LIGHT", (4.076, 1.005, 5.904))}


def put_aside(scene: bpy.types.Scene, view_layer: bpy.types.ViewLayer) -> list[str]:
    """Hide the untouched Cube and Light of Blender's startup file; their names."""
    names = []
    for obj in scene.objects:
        if obj.name not in view_layer.objects or not _is_untouched(obj):
            continue
        if obj.hide_render or obj.hide_get(view_layer=view_layer):
            continue
        obj.hide_set(True, view_layer=view_layer)
        obj.hide_render = True
        obj[_ASIDE] = True
        names.append(obj.name)
    return names


def bring_back(scene: bpy.types.Scene, view_layer: bpy.types.ViewLayer) -> None:
    """Show again what `put_aside` has hidden."""
    for obj in scene.objects:
        if _ASIDE in obj:
            del obj[_ASIDE]
            obj.hide_render = False
            if obj.name in view_layer.objects:
                obj.hide_set(False, view_layer=view_layer)


def _is_untouched(obj: bpy.types.Object) -> bool:
    kind, place = _STARTUP.get(obj.name, ("", (0.0, 0.0, 0.0)))
    moved, scaled = obj.location - Vector(place), obj.scale - Vector((1.0, 1.0, 1.0))
    if obj.type != kind or obj.modifiers or max(moved.length, scaled.length) > 1e-3:
        return False
    if kind == "LIGHT":
        return obj.data.type == "POINT" and abs(obj.data.energy - 1000.0) < 1e-3
    vertices = obj.data.vertices
    return len(vertices) == 8 and all(abs(x) == 1.0 for v in vertices for x in v.co)


_ROOM = 1.15  # how much farther off the view is than it need be


def frame(scene: bpy.types.Scene, centre: Sequence[float], radius: float) -> None:
    """Make the viewports of a scene look at a sphere, world."""
    for area in viewports(scene):
        _frame_area(area, Vector(centre), radius)


def _frame_area(area: bpy.types.Area, centre: Vector, radius: float) -> None:
    space = area.spaces.active
    view = space.region_3d
    if view.view_perspective == "CAMERA":
        view.view_perspective = "PERSP"
    width, height, left, right = _free_room(area)
    # Blender's viewport shows 72 mm along its longer side
    longer = max(width, height)
    half = 36.0 / space.lens * width / longer, 36.0 / space.lens * height / longer
    share = max(0.2, (width - left - right) / width)
    distance = _ROOM * radius * (1.0 + 1.0 / min(share * half[0], half[1]) ** 2) ** 0.5
    aside = Vector(((right - left) / width * half[0] * distance, 0.0, 0.0))
    view.view_location = centre + view.view_rotation @ aside
    view.view_distance = distance
    space.clip_start = min(space.clip_start, 1e-3 * radius)
    space.clip_end = max(space.clip_end, 20.0 * distance)


def _free_room(area: bpy.types.Area) -> tuple[int, int, int, int]:
    """Width and height of the viewport, and how much lies under tools and sidebar."""
    whole = next(region for region in area.regions if region.type == "WINDOW")
    under = {"TOOLS": 0, "UI": 0}
    for region in area.regions:
        if region.type in under and region.width > 1 and region.x < whole.x + whole.width:
            under[region.type] = region.width if region.x >= whole.x else 0
    return whole.width, whole.height, under["TOOLS"], under["UI"]
