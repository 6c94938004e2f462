# SPDX-License-Identifier: GPL-3.0-or-later
"""One Cycles render in, the ground-truth channels of one view out."""

import os
from pathlib import Path

import bpy
import numpy as np
import OpenEXR
import trimesh

from blender_scenes.format import ViewTruth
from blender_scenes.objects import TRUTH_SOCKETS
from blender_scenes.request import SceneRequest

SHADOW_OFFSET = 5e-4
"""Distance by which shadow rays start off the surface, scene units."""


def configure(request: SceneRequest) -> None:
    """Sets up Cycles and its passes in the open scene: unbiased radiance, box pixels, no dither."""
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.cycles.device = "CPU"
    scene.cycles.samples = request.samples
    scene.cycles.use_adaptive_sampling = False
    scene.cycles.sample_clamp_direct = 0.0
    scene.cycles.sample_clamp_indirect = 0.0
    scene.cycles.pixel_filter_type = "BOX"
    scene.cycles.filter_width = 1.0
    scene.cycles.max_bounces = request.variation.bounces
    scene.cycles.diffuse_bounces = 4
    scene.cycles.use_denoising = True
    scene.cycles.denoiser = "OPENIMAGEDENOISE"
    scene.cycles.denoising_prefilter = "NONE"
    scene.cycles.denoising_quality = "FAST"
    render = scene.render
    render.film_transparent = True
    render.use_persistent_data = True
    render.threads_mode = "FIXED"
    render.threads = 2
    render.dither_intensity = 0.0
    render.resolution_x = render.resolution_y = request.resolution
    render.resolution_percentage = 100
    settings = render.image_settings
    if hasattr(settings, "media_type"):  # Blender 5: must come before the file format
        settings.media_type = "MULTI_LAYER_IMAGE"
    settings.file_format = "OPEN_EXR_MULTILAYER"
    settings.color_depth = "32"
    settings.exr_codec = "ZIP"
    layer = bpy.context.view_layer
    layer.use_pass_position = layer.use_pass_normal = layer.use_pass_z = True
    for name in TRUTH_SOCKETS:
        aov = layer.aovs.add()
        aov.name = name
        aov.type = "COLOR" if name == "albedo" else "VALUE"


def add_camera(angle_x: float) -> bpy.types.Object:
    """Adds the one camera that all views are taken with."""
    data = bpy.data.cameras.new("camera")
    data.sensor_fit = "HORIZONTAL"
    data.angle = angle_x
    data.clip_end = 100.0
    camera = bpy.data.objects.new("camera", data)
    bpy.context.scene.collection.objects.link(camera)
    bpy.context.scene.camera = camera
    return camera


def scene_mesh() -> trimesh.Trimesh:
    """All render geometry, triangulated, in the world frame; modifiers applied."""
    graph = bpy.context.evaluated_depsgraph_get()
    vertices, faces, count = [], [], 0
    for obj in bpy.context.scene.objects:
        if obj.type != "MESH":
            continue
        evaluated = obj.evaluated_get(graph)
        mesh = evaluated.to_mesh()
        points = np.empty(3 * len(mesh.vertices), dtype=np.float32)
        mesh.vertices.foreach_get("co", points)
        mesh.calc_loop_triangles()
        corners = np.empty(3 * len(mesh.loop_triangles), dtype=np.int32)
        mesh.loop_triangles.foreach_get("vertices", corners)
        matrix = np.array(obj.matrix_world)
        vertices.append(points.reshape(-1, 3) @ matrix[:3, :3].T + matrix[:3, 3])
        faces.append(corners.reshape(-1, 3) + count)
        count += len(vertices[-1])
        evaluated.to_mesh_clear()
    return trimesh.Trimesh(np.concatenate(vertices), np.concatenate(faces), process=False)


def sun_visibility(
    position: np.ndarray, normal: np.ndarray, mesh: trimesh.Trimesh, sun_direction: np.ndarray
) -> np.ndarray:
    """Whether the sun's centre is seen from surface points.

    Args:
        position: (P, 3) points on the surface, world.
        normal: (P, 3) unit normals, world.
        mesh: what can be in the way.
        sun_direction: (3,) unit, towards the sun.

    Returns:
        (P,) float32: 1 where the surface faces the sun and nothing is in between, else 0.
    """
    facing = normal @ sun_direction > 0.0
    visible = np.zeros(len(position), dtype=np.float32)
    if facing.any():
        origins = position[facing] + SHADOW_OFFSET * normal[facing]
        directions = np.broadcast_to(sun_direction, origins.shape)
        visible[facing] = ~mesh.ray.intersects_any(origins, directions)
    return visible


def render_view(
    camera: bpy.types.Object,
    pose: np.ndarray,
    seed: int,
    mesh: trimesh.Trimesh,
    sun_direction: np.ndarray,
) -> ViewTruth:
    """Renders one view and gathers its ground truth.

    Args:
        camera: the scene's camera; moved to `pose`.
        pose: (4, 4) camera_to_world, OpenGL axes.
        seed: of the sampling noise.
        mesh: `scene_mesh()`.
        sun_direction: (3,) unit, towards the sun.

    Returns:
        The view's channels.
    """
    return _truth(_rendered(camera, pose, seed), mesh, sun_direction)


def render_radiance(
    camera: bpy.types.Object, pose: np.ndarray, seed: int
) -> tuple[np.ndarray, np.ndarray]:
    """Renders one view and gathers nothing else: straight radiance (H, W, 3), coverage (H, W).

    Args:
        camera: the scene's camera; moved to `pose`.
        pose: (4, 4) camera_to_world, OpenGL axes.
        seed: of the sampling noise.
    """
    channels = _rendered(camera, pose, seed)
    mask = channels["Combined.A"]
    return _straight(np.stack([channels[f"Combined.{a}"] for a in "RGB"], axis=-1), mask), mask


def _rendered(camera: bpy.types.Object, pose: np.ndarray, seed: int) -> dict[str, np.ndarray]:
    """Channels of a view by name."""
    scene = bpy.context.scene
    camera.matrix_world = pose.T  # Blender's matrices are filled by column
    scene.cycles.seed = seed
    file = Path(bpy.app.tempdir) / f"view_{os.getpid()}.exr"
    scene.render.filepath = str(file)
    bpy.ops.render.render(write_still=True)
    channels = _read_multilayer(file)
    file.unlink()
    return channels


def _straight(values: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Values (H, W) or (H, W, 3) of the covered part of each pixel, 0 where nothing is covered."""
    if values.ndim == 3:
        mask = mask[..., None]
    covered = mask > 0.0
    return np.where(covered, values / np.where(covered, mask, 1.0), 0.0)


def _read_multilayer(file: Path) -> dict[str, np.ndarray]:
    """Channels of a multi-layer EXR without the layer's name; in one part, or a part a pass."""
    channels = {}
    for part in OpenEXR.File(str(file), separate_channels=True).parts:
        for name, channel in part.channels.items():
            channels[name.split(".", 1)[1]] = np.asarray(channel.pixels)
    return channels


def _truth(
    channels: dict[str, np.ndarray], mesh: trimesh.Trimesh, sun_direction: np.ndarray
) -> ViewTruth:
    def stacked(name: str, axes: str) -> np.ndarray:
        return np.stack([channels[f"{name}.{axis}"] for axis in axes], axis=-1)

    mask = channels["Combined.A"]
    covered = mask > 0.0
    normal = stacked("Normal", "XYZ")
    length = np.linalg.norm(normal, axis=-1, keepdims=True)
    normal = np.where(length > 1e-6, normal / np.maximum(length, 1e-6), 0.0)
    hit = (channels["Depth.Z" if "Depth.Z" in channels else "Depth.V"] < 1e6) & covered
    position = np.where(hit[..., None], stacked("Position", "XYZ"), 0.0)
    visible = np.zeros_like(mask)
    visible[hit] = sun_visibility(position[hit], normal[hit], mesh, sun_direction)
    values = {name: _straight(channels[f"{name}.X"], mask) for name in ("roughness", "metallic")}
    return ViewTruth(
        radiance=_straight(stacked("Combined", "RGB"), mask),
        albedo=_straight(stacked("albedo", "RGB"), mask),
        normal=normal,
        position=position,
        mask=mask,
        hit=hit.astype(np.float32),
        sun_visibility=visible,
        **values,
    )
