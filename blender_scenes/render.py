# SPDX-License-Identifier: GPL-3.0-or-later
"""Builds a scene in Blender and renders what its cache folder still lacks."""

import contextlib
import importlib
import os
import sys
from collections.abc import Callable, Iterator
from dataclasses import asdict
from pathlib import Path

import bpy
import numpy as np
import trimesh

from blender_scenes import format as capture_format
from blender_scenes import lights, objects, passes, repaint, rig
from blender_scenes.request import SceneRequest, random_stream
from blender_scenes.wheel import wheel_version


def build_scene(request: SceneRequest, environment_file: Path) -> lights.LightRig:
    """Fills an empty Blender file with the scene and its light.

    Args:
        request: what is asked for.
        environment_file: where the environment map is written for Blender to read.

    Returns:
        The light.
    """
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = importlib.import_module(f"blender_scenes.scenes.{request.scene}")
    scene.build(request, random_stream(request, "layout"))
    repaint.repaint(request.variation)
    objects.add_ground(request.ground, random_stream(request, "ground"))
    used = {
        s.material for o in bpy.context.scene.objects if o.type == "MESH" for s in o.material_slots
    }
    for material in sorted(used, key=lambda m: m.name):
        objects.add_truth_outputs(material)
    light = lights.light_rig(request, random_stream(request, "light"))
    capture_format.write_environment(environment_file, light.environment)
    lights.add_lights(light, environment_file, float(np.radians(request.variation.sun_size)))
    bpy.context.view_layer.update()
    return light


def render_missing(
    request: SceneRequest, folder: Path, fingerprint: str, report: Callable[[int, int], None]
) -> int:
    """Renders every view that `folder` lacks, then its description.

    Args:
        request: what is asked for.
        folder: where linear renders live; laid out as `format.write_capture` wants it.
        fingerprint: of the request.
        report: called with the number of views done and of all views, after each.

    Returns:
        The number of views rendered now.
    """
    with _quiet():
        light = build_scene(request, folder / "environment.exr")
        passes.configure(request)
        camera = passes.add_camera(rig.CAMERA_ANGLE_X)
        mesh = passes.scene_mesh()
    rendered = done = 0
    poses = {
        "train": rig.camera_poses(request.views, random_stream(request, "train")),
        "test": rig.camera_poses(request.test_views, random_stream(request, "test")),
    }
    for split in capture_format.SPLITS:
        (folder / split).mkdir(exist_ok=True)
        for index, pose in enumerate(poses[split]):
            file = folder / split / f"{capture_format.view_name(index)}.exr"
            if not file.exists():
                with _quiet():
                    seed = index + (100_000 if split == "test" else 0)
                    view = passes.render_view(camera, pose, seed, mesh, light.sun_direction)
                capture_format.write_view(file, view)
                rendered += 1
            done += 1
            report(done, request.views + request.test_views)
        transforms = capture_format.transforms(
            poses[split], split, rig.CAMERA_ANGLE_X, request.resolution
        )
        capture_format.write_json(folder / f"transforms_{split}.json", transforms)
    _write_mesh(folder / "mesh.ply", mesh)
    capture_format.write_json(
        folder / "scene.json", _description(request, light, mesh, fingerprint)
    )
    return rendered


def _description(
    request: SceneRequest, light: lights.LightRig, mesh: trimesh.Trimesh, fingerprint: str
) -> dict:
    """What scene.json holds apart from the tone mapping."""
    centre = mesh.bounds.mean(axis=0)
    return {
        "format_version": capture_format.FORMAT_VERSION,
        "scene": request.scene,
        "ground": request.ground,
        "light": request.light,
        "preset": request.preset,
        "seed": request.seed,
        "variation": asdict(request.variation),
        "resolution": request.resolution,
        "samples": request.samples,
        "views": request.views,
        "test_views": request.test_views,
        "hdri": request.hdri.name if request.hdri else None,
        "asset": request.asset.name if request.asset else None,
        "fingerprint": fingerprint,
        "blender": wheel_version(),
        "sun_direction": light.sun_direction.tolist(),
        "sun_irradiance_rgb": light.sun_irradiance_rgb.tolist(),
        "sun_is_lamp": bool(light.lamps),
        "scene_centre": centre.tolist(),
        "scene_radius": float(np.linalg.norm(mesh.vertices - centre, axis=1).max()),
    }


def _write_mesh(file: Path, mesh: trimesh.Trimesh) -> None:
    temporary = file.with_name(f".{os.getpid()}.{file.name}")
    temporary.write_bytes(trimesh.exchange.ply.export_ply(mesh, encoding="binary"))
    temporary.replace(file)


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Sends what Blender prints on standard output to nowhere."""
    sys.stdout.flush()
    saved = os.dup(1)
    with Path(os.devnull).open("w", encoding="utf-8") as sink:
        os.dup2(sink.fileno(), 1)
        try:
            yield
        finally:
            sys.stdout.flush()
            os.dup2(saved, 1)
            os.close(saved)
