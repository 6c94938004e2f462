# SPDX-License-Identifier: GPL-3.0-or-later
"""Capture cameras as Blender cameras that project every point to the same pixel."""

from pathlib import Path
from typing import Any

import bpy
import numpy as np
from mathutils import Matrix, Vector

SENSOR_WIDTH = 36.0
# custom property with the view's name; Blender may have to number the object's own
VIEW = "robir_view"
_MARGIN = 0.08  # share of a close-up's width that is left free on either side
_SIZE = "robir_size"
_ASPECT = "robir_aspect"
_SPLIT = "robir_split"


def add_camera(view: dict[str, Any], folder: Path, centre: list[float]) -> bpy.types.Object:
    """A camera for a view of cameras.json, its image below `folder`; not yet in a collection."""
    data = bpy.data.cameras.new(view["name"])
    width, height, fx, fy = view["width"], view["height"], view["fx"], view["fy"]
    # a pixel is drawn 1/f wide and high: one of the two aspects is always 1
    aspect_x, aspect_y = (1.0, fx / fy) if fx >= fy else (fy / fx, 1.0)
    data.sensor_fit = "HORIZONTAL"
    data.sensor_width = SENSOR_WIDTH
    data.lens = fx * SENSOR_WIDTH / width
    data.shift_x = -(view["cx"] - 0.5 * width) / width
    data.shift_y = (view["cy"] - 0.5 * height) / width * (aspect_y / aspect_x)
    camera = bpy.data.objects.new(view["name"], data)
    camera.matrix_world = Matrix(view["camera_to_world"])
    # in proportion to how far off the subject is, so that nothing near or far is cut away
    distance = max((camera.location - Vector(centre)).length, 1e-3)
    data.clip_start, data.clip_end = 1e-3 * distance, 1e3 * distance
    data.display_size = 0.05 * distance
    camera[VIEW] = view["name"]
    camera[_SIZE] = (width, height)
    camera[_ASPECT] = (aspect_x, aspect_y)
    camera[_SPLIT] = view["split"]
    data.show_background_images = True
    photo = data.background_images.new()
    photo.image = bpy.data.images.load(str((folder / view["image"]).resolve()))
    photo.frame_method = "STRETCH"
    photo.alpha = 1.0
    return camera


def use_camera(scene: bpy.types.Scene, camera: bpy.types.Object, max_side: int = 0) -> None:
    """Make a capture camera the scene's, with its picture size; its side at most so long, or 0."""
    width, height = camera[_SIZE]
    shrink = min(1.0, max_side / max(width, height)) if max_side else 1.0
    scene.camera = camera
    render = scene.render
    render.resolution_x = max(1, round(width * shrink))
    render.resolution_y = max(1, round(height * shrink))
    render.resolution_percentage = 100
    render.pixel_aspect_x, render.pixel_aspect_y = camera[_ASPECT]


def use_close_up(
    scene: bpy.types.Scene, camera: bpy.types.Object, points: np.ndarray, side: int
) -> None:
    """See points large from where a capture camera stands; as it does, where some lie behind it."""
    inverse = np.array(camera.matrix_world.inverted())
    seen = points @ inverse[:3, :3].T + inverse[:3, 3]
    use_camera(scene, camera, side)
    if not len(seen) or seen[:, 2].max() > -camera.data.clip_start:
        return
    slopes = seen[:, :2] / -seen[:, 2:]
    low, high = slopes.min(0), slopes.max(0)
    middle, width = 0.5 * (low + high), float((high - low).max()) / (1.0 - 2.0 * _MARGIN)
    if not width > 0.0:
        return
    near = camera.copy()
    near.data = camera.data.copy()
    near.data.lens = SENSOR_WIDTH / width
    near.data.shift_x, near.data.shift_y = middle / width
    scene.collection.objects.link(near)
    scene.camera = near
    render = scene.render
    render.resolution_x = render.resolution_y = side
    render.pixel_aspect_x = render.pixel_aspect_y = 1.0


def capture_cameras(scene: bpy.types.Scene, split: str | None = None) -> list[bpy.types.Object]:
    """The scene's capture cameras in the order of their views' names, of one split or all."""
    cameras = [o for o in scene.objects if o.type == "CAMERA" and _SIZE in o]
    chosen = [c for c in cameras if split is None or c[_SPLIT] == split]
    return sorted(chosen, key=lambda camera: camera[VIEW])
