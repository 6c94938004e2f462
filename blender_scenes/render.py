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
from trimesh.exchange.ply import export_ply

from blender_scenes import format as capture_format
from blender_scenes import lights, objects, passes, repaint, rig
from blender_scenes.recipe import SecondLight
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
    lights.add_lights(light, environment_file)
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
    poses = _poses(request, mesh)
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
    if request.recipe is not None:
        _relight(request.recipe.second_light, folder, camera, poses["test"])
    _write_mesh(folder / "mesh.ply", mesh)
    capture_format.write_json(
        folder / "scene.json", _description(request, light, mesh, fingerprint)
    )
    return rendered


def _poses(request: SceneRequest, mesh: trimesh.Trimesh) -> dict[str, np.ndarray]:
    """Cameras (V, 4, 4) of each split."""
    found = {}
    for split, count in (("train", request.views), ("test", request.test_views)):
        rng = random_stream(request, split)
        if request.recipe is None:
            found[split] = rig.camera_poses(count, rng)
        else:
            centre, radius = _sphere(mesh)
            found[split] = rig.drawn_poses(count, rng, request.recipe.cameras, centre, radius)
    return found


def _sphere(mesh: trimesh.Trimesh) -> tuple[np.ndarray, float]:
    """Middle (3,) of the bounding box and radius of the sphere about it that holds a mesh."""
    centre = mesh.bounds.mean(axis=0)
    return centre, float(np.linalg.norm(mesh.vertices - centre, axis=1).max())


def _relight(
    second: SecondLight, folder: Path, camera: bpy.types.Object, poses: np.ndarray
) -> None:
    """Renders the test views once more under another map.

    Args:
        second: the map.
        folder: of the linear renders.
        camera: the scene's.
        poses: (V, 4, 4) of the test views.
    """
    with _quiet():
        environment = lights.second_map(second.file, second.turn)
        file = folder / capture_format.SECOND_LIGHT
        capture_format.write_environment(file, environment)
        # a map alone: where its sun stands is nobody's business here
        nowhere = np.array([0.0, 0.0, 1.0])
        lights.add_lights(lights.LightRig(environment, nowhere, np.zeros(3)), file)
        (folder / "relit").mkdir(exist_ok=True)
        for index, pose in enumerate(poses):
            radiance, mask = passes.render_radiance(camera, pose, index)
            name = f"{capture_format.view_name(index)}.exr"
            capture_format.write_relit(folder / "relit" / name, radiance, mask)


def _description(
    request: SceneRequest, light: lights.LightRig, mesh: trimesh.Trimesh, fingerprint: str
) -> dict:
    """What scene.json holds apart from the tone mapping."""
    centre, radius = _sphere(mesh)
    return {
        "format_version": capture_format.FORMAT_VERSION,
        "scene": request.scene,
        "ground": _ground_name(request),
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
        "sun_share": light.sun_share,
        "lamps": [
            {
                "direction": lamp.direction.tolist(),
                "irradiance_rgb": lamp.irradiance_rgb.tolist(),
                "size": lamp.size,
            }
            for lamp in light.lamps
        ],
        "scene_centre": centre.tolist(),
        "scene_radius": radius,
    }


def _ground_name(request: SceneRequest) -> str:
    """The ground as the command line calls it, or as the recipe says it."""
    if request.recipe is None:
        return request.ground
    ground = request.recipe.ground
    return "none" if ground is None else f"{ground.paint.pattern} {ground.shape}"


def _write_mesh(file: Path, mesh: trimesh.Trimesh) -> None:
    temporary = file.with_name(f".{os.getpid()}.{file.name}")
    temporary.write_bytes(export_ply(mesh, encoding="binary"))
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
