# SPDX-License-Identifier: Apache-2.0
"""A tiny textured sphere with everything known: a capture with truth and a perfect result of it.

The light is a uniform sky and a small sun, so a diffuse sphere's radiance has a closed form:
albedo / pi (pi sky + sun max(n.l, 0)). The sphere is neither at the origin nor of radius one.
"""

import functools
import json
from pathlib import Path

import numpy as np
import OpenEXR
from PIL import Image

from robir.capture.camera import Camera
from robir.capture.capture import Bounds, Capture, View
from robir.capture.store import save_capture
from robir.evaluation.layers import Layers, view_layers
from robir.evaluation.metrics import srgb_from_linear
from robir.export.textures import TexturedPart, Textures
from robir.geometry.mesh.triangles import Mesh
from robir.jobs.paths import STAGES, JobPaths, write_json

CENTRE = np.array([0.3, -0.2, 0.5])
RADIUS = 1.3
SPHERE = 0.9
SIZE = 64
TEXELS = 128
MARGIN = 0.125
SKY = np.array([0.5, 0.55, 0.7])
SUN = np.array([1.6, 1.5, 1.3])
SUN_DIRECTION = np.array([2.0, -1.0, 2.0]) / 3.0
SHARPNESS = 3000.0


def sphere_mesh(columns=48, rows=24) -> Mesh:
    """Unit-frame sphere whose chart is a square in the middle of the atlas."""
    u, v = np.meshgrid(np.linspace(0, 1, columns + 1), np.linspace(0, 1, rows + 1))
    angle, height = 2 * np.pi * u.ravel(), np.pi * (v.ravel() - 0.5)
    normals = np.stack(
        [np.cos(height) * np.cos(angle), np.cos(height) * np.sin(angle), np.sin(height)], axis=1
    )
    i = (np.arange(rows)[:, None] * (columns + 1) + np.arange(columns)).ravel()
    lower = np.stack([i, i + 1, i + columns + 2], axis=1)[columns:]
    upper = np.stack([i, i + columns + 2, i + columns + 1], axis=1)[:-columns]
    uvs = MARGIN + (1 - 2 * MARGIN) * np.stack([u.ravel(), v.ravel()], axis=1)
    faces = np.concatenate([lower, upper]).astype(np.int32)
    return Mesh(
        vertices=(SPHERE * normals).astype(np.float32),
        faces=faces,
        normals=normals.astype(np.float32),
        uvs=uvs.astype(np.float32),
        uv_faces=faces,
    )


def sphere_textures() -> dict[str, np.ndarray]:
    """A checkerboard of two materials."""
    rows, columns = (np.mgrid[:TEXELS, :TEXELS] + 0.5) / TEXELS
    u, v = columns, 1 - rows
    board = (np.floor(u * 16) + np.floor(v * 8)) % 2 == 0
    albedo = np.where(board[..., None], [0.6, 0.25, 0.15], [0.15, 0.3, 0.5])
    inside = (np.abs(u - 0.5) < 0.5 - MARGIN) & (np.abs(v - 0.5) < 0.5 - MARGIN)
    value = {
        "albedo_linear": np.where(inside[..., None], albedo, 0.0),
        "roughness": np.where(inside, np.where(board, 0.7, 0.4), 0.0),
        "metallic": np.zeros((TEXELS, TEXELS)),
        "coverage": np.where(inside, 6.0, 0.0),
        "uncertainty": np.where(inside, 0.1, 0.0),
    }
    return {name: array.astype(np.float32) for name, array in value.items()} | {"inside": inside}


def cameras(count: int, turn: float) -> list[Camera]:
    """Cameras on a ring about the sphere, capture frame."""
    made = []
    for k in range(count):
        angle = 2 * np.pi * (k + turn) / count
        back = np.array([0.8 * np.cos(angle), 0.8 * np.sin(angle), 0.6])
        right = np.array([-np.sin(angle), np.cos(angle), 0.0])
        pose = np.eye(4)
        pose[:3, :3] = np.stack([right, np.cross(back, right), back], axis=1)
        pose[:3, 3] = CENTRE + 4.5 * back
        f = 1.5 * SIZE
        made.append(
            Camera(
                width=SIZE, height=SIZE, fx=f, fy=f, cx=SIZE / 2, cy=SIZE / 2, camera_to_world=pose
            )
        )
    return made


@functools.cache
def seen(count: int, turn: float) -> tuple[Layers, ...]:
    """What these cameras see of the sphere; traced once, and not to be written to."""
    return tuple(view_layers(world_mesh(), sphere_textures(), cameras(count, turn)))


def world_mesh() -> Mesh:
    """The sphere in the capture's frame."""
    mesh = sphere_mesh()
    vertices = (mesh.vertices * RADIUS + CENTRE).astype(np.float32)
    return Mesh(
        vertices=vertices,
        faces=mesh.faces,
        normals=mesh.normals,
        uvs=mesh.uvs,
        uv_faces=mesh.uv_faces,
    )


def parts(textures: Textures) -> list[TexturedPart]:
    """The sphere as a glTF file has it."""
    return [TexturedPart(tile=None, mesh=world_mesh(), textures=textures)]


def photograph(layers) -> np.ndarray:
    """Display-referred picture (H, W, 3) through the Standard curve."""
    sun = np.maximum(layers.normal @ SUN_DIRECTION, 0.0)[..., None] * SUN
    return (
        srgb_from_linear(layers.albedo_linear / np.pi * (np.pi * SKY + sun)) * layers.hit[..., None]
    )


def light_table() -> dict:
    """The light of the scene as lobes; the sky is one lobe so wide that it is uniform."""
    energy = 2 * np.pi / SHARPNESS * -np.expm1(-2 * SHARPNESS)
    lobes = [
        {"axis": [0.0, 0.0, 1.0], "sharpness": 1e-3, "amplitude": SKY.tolist(), "kind": "soft"},
        {
            "axis": SUN_DIRECTION.tolist(),
            "sharpness": SHARPNESS,
            "amplitude": (SUN / energy).tolist(),
            "kind": "sharp",
        },
    ]
    return {"lobes": lobes, "unit": "radiance such that the tone curve maps it to display"}


def make_truth(folder: Path) -> Path:
    """Write a capture with truth as `blender_scenes` does; returns its folder."""
    mesh = world_mesh()
    for split, count, turn in (("train", 6, 0.0), ("test", 3, 0.5)):
        views = cameras(count, turn)
        (folder / split).mkdir(parents=True)
        (folder / "truth" / split).mkdir(parents=True)
        frames = []
        for k, layers in enumerate(seen(count, turn)):
            codes = np.round(255 * np.dstack([photograph(layers), layers.hit])).astype(np.uint8)
            Image.fromarray(codes).save(folder / split / f"r_{k:03d}.png")
            write_view_truth(folder / "truth" / split / f"r_{k:03d}.exr", layers)
            pose = views[k].camera_to_world.tolist()
            frames.append({"file_path": f"./{split}/r_{k:03d}", "transform_matrix": pose})
        angle = 2 * np.arctan(0.5 * SIZE / views[0].fx)
        table = {"camera_angle_x": angle, "w": SIZE, "h": SIZE, "fl_x": views[0].fx}
        table |= {"fl_y": views[0].fy, "cx": SIZE / 2, "cy": SIZE / 2, "frames": frames}
        (folder / f"transforms_{split}.json").write_text(json.dumps(table))
    environment = np.broadcast_to(SKY, (32, 64, 3)).astype(np.float32)
    planes = {axis: np.ascontiguousarray(environment[..., i]) for i, axis in enumerate("RGB")}
    save_planes(folder / "truth" / "environment.exr", planes)
    solid = mesh_as_trimesh(mesh)
    solid.export(folder / "truth" / "mesh.ply")
    scene = {"format_version": 1, "scene": "sphere", "ground": "none", "light": "lamp", "seed": 0}
    scene |= {"view_transform": "Standard", "sun_direction": SUN_DIRECTION.tolist()}
    scene |= {"sun_irradiance_rgb": SUN.tolist(), "sun_is_lamp": True}
    scene |= {"scene_radius": RADIUS * SPHERE, "scene_centre": CENTRE.tolist()}
    (folder / "truth" / "scene.json").write_text(json.dumps(scene))
    return folder


def mesh_as_trimesh(mesh: Mesh):
    import trimesh

    return trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)


def write_view_truth(file: Path, layers) -> None:
    planes = {"roughness": layers.roughness, "mask": layers.hit, "hit": layers.hit}
    planes["sun_visibility"] = layers.normal @ SUN_DIRECTION > 0
    for name, axes, image in (
        ("albedo", "RGB", layers.albedo_linear),
        ("normal", "XYZ", layers.normal),
        ("position", "XYZ", layers.position),
    ):
        planes |= {f"{name}.{axis}": image[..., i] for i, axis in enumerate(axes)}
    save_planes(file, planes)


def save_planes(file: Path, planes: dict[str, np.ndarray]) -> None:
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    values = {name: np.ascontiguousarray(p, np.float32) for name, p in planes.items()}
    OpenEXR.File(header, values).write(str(file))


def make_run(root: Path, textures: dict[str, np.ndarray] | None = None) -> JobPaths:
    """Write a result folder whose stages up to appearance are done and perfect."""
    paths = JobPaths(root)
    textures = sphere_textures() if textures is None else textures
    views = []
    for split, count, turn in (("train", 6, 0.0), ("held_out", 3, 0.5)):
        poses = cameras(count, turn)
        for k, layers in enumerate(seen(count, turn)):
            views.append(
                View(
                    name=f"{split}_{k:03d}",
                    image_display=np.round(255 * photograph(layers)).astype(np.uint8),
                    mask=(255 * layers.hit).astype(np.uint8),
                    camera=poses[k],
                    split=split,
                )
            )
    bounds = Bounds(centre=CENTRE, radius=RADIUS, origin="known")
    capture = Capture(
        source=root / "capture", format="nerf-synthetic", views=tuple(views), bounds=bounds
    )
    for stage in STAGES:
        paths.stage(stage).mkdir(parents=True)
    save_capture(paths.stage("capture"), capture)
    sphere_mesh().save(paths.stage("geometry") / "mesh.npz")
    appearance = paths.stage("appearance")
    np.savez(appearance / "textures.npz", **textures)
    write_json(appearance / "light.json", light_table())
    candidates = [
        {"family": "standard", "score": 0.010, "standard_error": 0.001, "albedo_apart": None},
        {"family": "filmic", "score": 0.031, "standard_error": 0.002, "albedo_apart": None},
    ]
    write_json(
        appearance / "tone_curve.json",
        {
            "family": "standard",
            "parameters": {},
            "candidates": candidates,
            "clipped_share": 0.0,
            "blender_view_transform": "Standard",
            "exposure": 0.0,
        },
    )
    write_json(
        appearance / "choices.json",
        [
            {
                "choice": "tone curve",
                "chosen": "standard",
                "alternatives": ["filmic"],
                "held_out_error": 0.01,
                "cost_seconds": 1.2,
                "why": "a spike at 255",
            }
        ],
    )
    exposure = {"steps": {}, "corner_steps": 0.0, "slope_steps": {}, "other_light": []}
    write_json(appearance / "exposure.json", exposure)
    held_out = {v.name: v.image_display for v in views if v.split == "held_out"}
    np.savez(appearance / "held_out.npz", **held_out)
    for stage in STAGES[:-1]:
        write_json(paths.manifest(stage), {"stage": stage})
    write_json(
        paths.run,
        {
            "robir_version": "0.1.0",
            "device": "cpu",
            "seed": 0,
            "capture": {"name": "capture"},
            "seconds": {stage: {"wall": 2.0, "cpu": 1.5} for stage in STAGES[:-1]},
            "warnings": [],
        },
    )
    return paths
