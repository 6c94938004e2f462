# SPDX-License-Identifier: GPL-3.0-or-later
"""Builds a capture of photographs in Blender and renders what its folder still lacks.

The folder then holds `shots/r_*.exr` (radiance and the thing's coverage of every photograph),
`test/r_*.exr` (the whole truth of some of them), `relit/`, `environment.exr`, `mesh.ply`, and
`scene.json`.
"""

import contextlib
import os
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np
import OpenEXR
import trimesh
from trimesh.exchange.ply import export_ply

from blender_scenes import format as capture_format
from blender_scenes import lights, passes
from blender_scenes.environment import sun_spot
from blender_scenes.photographs import surroundings
from blender_scenes.photographs.finishes import THING
from blender_scenes.photographs.posing import walked_poses
from blender_scenes.photographs.recipe import PhotoRecipe
from blender_scenes.photographs.things import add_thing
from blender_scenes.request import SceneRequest
from blender_scenes.wheel import wheel_version

TEST_VIEWS = 6
"""How many photographs have the whole truth."""

BOUNCES = 3
PANORAMA = (512, 256)
PANORAMA_SAMPLES = 4
RELIT_SAMPLES = 4
POINTS = 60
"""Of the surface, that each photograph adds to a sparse model."""

FAR = 1e6
"""Depth from which on a ray met nothing."""


@dataclass(frozen=True)
class Stage:
    """The scene, built.

    Attributes:
        pieces: of the thing.
        mesh: of the thing, world frame.
        shading: the same with the table.
        poses: (V, 4, 4) of all photographs.
        rig: of the light, or black.
    """

    pieces: list[bpy.types.Object]
    mesh: trimesh.Trimesh
    shading: trimesh.Trimesh
    poses: np.ndarray
    rig: lights.LightRig

    @property
    def sphere(self) -> tuple[np.ndarray, float]:
        """Middle (3,) of the thing's bounding box, and how far the thing reaches from it."""
        centre = self.mesh.bounds.mean(axis=0)
        return centre, float(np.linalg.norm(self.mesh.vertices - centre, axis=1).max())


def test_indices(poses: np.ndarray, centre: np.ndarray) -> list[int]:
    """Photographs that have the whole truth.

    Every eighth from the fifth on: those that are commonly kept aside, by RobIR too, so that what
    is shown there can be judged as well. Where these are few, those farthest from them join.
    """
    outward = poses[:, :3, 3] - centre
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    chosen = list(range(4, len(poses), 8))[:TEST_VIEWS] or [0]
    while len(chosen) < min(TEST_VIEWS, len(poses)):
        nearness = (outward @ outward[chosen].T).max(axis=1)
        chosen.append(int(np.argmin(nearness)))
    return sorted(chosen)


def build(recipe: PhotoRecipe, environment_file: Path) -> Stage:
    """Fills an empty Blender file with the scene and sets up the renderer."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    pieces = add_thing(recipe.thing)
    bpy.context.view_layer.update()
    mesh = passes.scene_mesh()
    surroundings.add_table(recipe.table)
    bpy.context.view_layer.update()
    shading = passes.scene_mesh()
    centre = mesh.bounds.mean(axis=0)
    radius = float(np.linalg.norm(mesh.vertices - centre, axis=1).max())
    poses = walked_poses(recipe.walk, recipe.frame, centre, radius)
    rig = surroundings.add_light(recipe, poses, environment_file)
    bpy.context.view_layer.update()
    _configure(recipe)
    return Stage(pieces, mesh, shading, poses, rig)


def _configure(recipe: PhotoRecipe) -> None:
    """As the other half is rendered, but with what is behind the thing."""
    unused = {"resolution": 8, "scene": "truck", "ground": "none", "light": "lamp"}
    passes.configure(SceneRequest(samples=recipe.samples, **unused))
    scene, layer = bpy.context.scene, bpy.context.view_layer
    scene.cycles.max_bounces = BOUNCES
    scene.cycles.caustics_reflective = scene.cycles.caustics_refractive = False
    scene.cycles.sample_clamp_indirect = 8.0
    scene.cycles.use_light_tree = False
    scene.render.film_transparent = False
    scene.render.resolution_x, scene.render.resolution_y = recipe.frame.width, recipe.frame.height
    scene.render.image_settings.exr_codec = "NONE"
    layer.use_pass_object_index = True
    aov = layer.aovs.add()
    aov.name, aov.type = THING, "VALUE"
    camera = passes.add_camera(float(np.radians(recipe.frame.angle)))
    camera.data.sensor_fit = "AUTO"


def render_missing(
    recipe: PhotoRecipe, folder: Path, fingerprint: str, report: Callable[[int, int], None]
) -> None:
    """Renders every photograph that `folder` lacks, then its truth and description.

    Args:
        recipe: what is asked for.
        folder: where linear renders live.
        fingerprint: of the recipe.
        report: called with the number of photographs done and of all, after each.
    """
    for name in ("shots", "test", "relit", "points"):
        (folder / name).mkdir(parents=True, exist_ok=True)
    with _quiet():
        stage = build(recipe, folder / "map.exr")
    environment = _panorama(recipe, stage, folder)
    rig = _seen_rig(stage, environment)
    tests = test_indices(stage.poses, stage.sphere[0])
    for index, pose in enumerate(stage.poses):
        name = f"{capture_format.view_name(index)}.exr"
        if not (folder / "shots" / name).exists():
            with _quiet():
                channels = _rendered(pose, index)
            if index in tests:
                truth = _truth(channels, stage.shading, rig.sun_direction)
                capture_format.write_view(folder / "test" / name, truth)
            _write_points(folder / "points" / f"{name}.npy", channels, recipe.seed + index)
            radiance = _stacked(channels, "Combined", "RGB")
            capture_format.write_relit(folder / "shots" / name, radiance, _coverage(channels))
        report(index + 1, len(stage.poses))
    _relight(recipe, stage, folder, tests)
    _write_mesh(folder / "mesh.ply", stage.mesh)
    capture_format.write_json(
        folder / "scene.json",
        _description(recipe, stage, rig, tests) | {"fingerprint": fingerprint},
    )


def _coverage(channels: dict[str, np.ndarray]) -> np.ndarray:
    return np.clip(channels[f"{THING}.X"], 0.0, 1.0)


def _panorama(recipe: PhotoRecipe, stage: Stage, folder: Path) -> np.ndarray:
    """What the thing sees all round, itself taken away: (H, 2H, 3) lat-long, z up.

    The lamps of a map's rig are not in it: they are distant and told of beside it.
    """
    file = folder / "environment.exr"
    scene = bpy.context.scene
    if file.exists():
        with OpenEXR.File(str(file)) as opened:
            return np.asarray(opened.channels()["RGB"].pixels)
    camera = scene.camera
    camera.data.type = "PANO"
    owner = camera.data if hasattr(camera.data, "panorama_type") else camera.data.cycles
    owner.panorama_type = "EQUIRECTANGULAR"
    scene.render.resolution_x, scene.render.resolution_y = PANORAMA
    scene.cycles.samples = PANORAMA_SAMPLES
    for piece in stage.pieces:
        piece.hide_render = True
    pose = np.eye(4)
    # the picture's middle looks to +x, its top is +z
    pose[:3, :3] = np.array([[0.0, 0.0, -1.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    pose[:3, 3] = stage.sphere[0]
    with _quiet():
        seen = _stacked(_rendered(pose, 77), "Combined", "RGB")
    for piece in stage.pieces:
        piece.hide_render = False
    camera.data.type = "PERSP"
    scene.render.resolution_x, scene.render.resolution_y = recipe.frame.width, recipe.frame.height
    scene.cycles.samples = recipe.samples
    capture_format.write_environment(file, seen)
    return seen


def _seen_rig(stage: Stage, environment: np.ndarray) -> lights.LightRig:
    """The light as the thing sees it, its sun the rig's, or the brightest spot."""
    if stage.rig.lamps:
        sun = stage.rig
        return lights.LightRig(environment, sun.sun_direction, sun.sun_irradiance_rgb, sun.lamps)
    direction, spot = sun_spot(environment)
    return lights.LightRig(environment, direction, spot)


def _relight(recipe: PhotoRecipe, stage: Stage, folder: Path, tests: list[int]) -> None:
    """The thing alone under another map, in the photographs that have the whole truth."""
    second = recipe.second_light
    with _quiet():
        environment = lights.second_map(second.file, second.turn)
        file = folder / capture_format.SECOND_LIGHT
        capture_format.write_environment(file, environment)
        lights.add_lights(
            lights.LightRig(environment, np.array([0.0, 0.0, 1.0]), np.zeros(3)), file
        )
        surroundings.only(stage.pieces)
        bpy.context.scene.render.film_transparent = True
        bpy.context.scene.cycles.samples = RELIT_SAMPLES
        for index in tests:
            radiance, mask = passes.render_radiance(
                bpy.context.scene.camera, stage.poses[index], index
            )
            name = f"{capture_format.view_name(index)}.exr"
            capture_format.write_relit(folder / "relit" / name, radiance, mask)


def _rendered(pose: np.ndarray, seed: int) -> dict[str, np.ndarray]:
    """Channels of a view by name."""
    scene = bpy.context.scene
    scene.camera.matrix_world = pose.T  # Blender's matrices are filled by column
    scene.cycles.seed = seed
    file = Path(bpy.app.tempdir) / f"photograph_{os.getpid()}.exr"
    scene.render.filepath = str(file)
    bpy.ops.render.render(write_still=True)
    channels = {}
    for part in OpenEXR.File(str(file), separate_channels=True).parts:
        for name, channel in part.channels.items():
            channels[name.split(".", 1)[1]] = np.asarray(channel.pixels)
    file.unlink()
    return channels


def _stacked(channels: dict[str, np.ndarray], name: str, axes: str) -> np.ndarray:
    return np.stack([channels[f"{name}.{axis}"] for axis in axes], axis=-1)


def _truth(
    channels: dict[str, np.ndarray], shading: trimesh.Trimesh, sun_direction: np.ndarray
) -> capture_format.ViewTruth:
    """The channels of the thing; radiance is of the whole picture."""
    mask = _coverage(channels)
    covered = mask > 0.0
    share = np.where(covered, mask, 1.0)
    index = next(name for name in channels if name.startswith("IndexOB") or "Object Index" in name)
    hit = (channels[index] > 0.5) & covered
    normal = _stacked(channels, "Normal", "XYZ")
    length = np.linalg.norm(normal, axis=-1, keepdims=True)
    normal = np.where(hit[..., None], normal / np.maximum(length, 1e-6), 0.0)
    position = np.where(hit[..., None], _stacked(channels, "Position", "XYZ"), 0.0)
    visible = np.zeros_like(mask)
    visible[hit] = passes.sun_visibility(position[hit], normal[hit], shading, sun_direction)
    plain = {name: np.where(covered, channels[f"{name}.X"] / share, 0.0)
             for name in ("roughness", "metallic")}  # fmt: skip
    albedo = np.where(covered[..., None], _stacked(channels, "albedo", "RGB") / share[..., None], 0)
    return capture_format.ViewTruth(
        radiance=_stacked(channels, "Combined", "RGB"), albedo=albedo, normal=normal,
        position=position, mask=mask, hit=hit.astype(np.float32), sun_visibility=visible, **plain,
    )  # fmt: skip


def _write_points(file: Path, channels: dict[str, np.ndarray], seed: int) -> None:
    """Surface points (N, 3) that a photograph shows, where it has something to hold on to."""
    grey = np.log(np.maximum(_stacked(channels, "Combined", "RGB").mean(axis=-1), 1e-4))
    edge = np.hypot(*np.gradient(grey))
    edge[channels["Depth.Z" if "Depth.Z" in channels else "Depth.V"] > FAR] = 0.0
    rng = np.random.default_rng(seed)
    weight = edge.ravel() + 1e-9
    chosen = rng.choice(weight.size, POINTS, p=weight / weight.sum())
    points = _stacked(channels, "Position", "XYZ").reshape(-1, 3)[chosen]
    np.save(file, points[np.linalg.norm(points, axis=1) < FAR])


def _description(recipe: PhotoRecipe, stage: Stage, rig: lights.LightRig, tests: list[int]) -> dict:
    """What scene.json holds apart from how the photographs were taken."""
    centre, radius = stage.sphere
    table = recipe.table
    return {
        "format_version": capture_format.FORMAT_VERSION,
        "scene": "photographs",
        "ground": f"{table.finish.pattern} {table.shape} table",
        "light": recipe.light.kind,
        "seed": recipe.seed,
        "samples": recipe.samples,
        "views": len(stage.poses),
        "test_views": len(tests),
        "hdri": recipe.light.file.name,
        "asset": recipe.thing.file.name if recipe.thing.file else None,
        "blender": wheel_version(),
        "sun_direction": rig.sun_direction.tolist(),
        "sun_irradiance_rgb": rig.sun_irradiance_rgb.tolist(),
        "sun_is_lamp": bool(rig.lamps),
        "sun_share": rig.sun_share,
        "lamps": [
            {
                "direction": lamp.direction.tolist(),
                "irradiance_rgb": lamp.irradiance_rgb.tolist(),
                "size": lamp.size,
            }
            for lamp in rig.lamps
        ],
        "scene_centre": centre.tolist(),
        "scene_radius": radius,
        "tests": tests,
        "poses": stage.poses.tolist(),
    }


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
