# SPDX-License-Identifier: GPL-3.0-or-later
"""Makes the capture folder of photographs: what a user brings, and `truth` beside it."""

import json
import os
import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
from PIL import Image
from scipy.spatial.transform import Rotation

from blender_scenes.environment import UP, irradiance
from blender_scenes.format import SECOND_LIGHT, view_name, write_json
from blender_scenes.photographs.developing import Shot, display, shots
from blender_scenes.photographs.matting import mask, wavy_mask
from blender_scenes.photographs.posing import erroneous, placed
from blender_scenes.photographs.recipe import Frame, PhotoRecipe
from blender_scenes.view_transform import codes_from_display

RESPONSE = "camera response"
"""In scene.json, where the other half names a view transform; the numbers stand beside it."""

CAMERAS = "cameras.json"
"""Named and laid out so that no reader of captures takes it for poses that a user gives."""

_OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])
_SMALL_FORMAT_DIAGONAL = 43.267
"""Millimetres, for the focal length that EXIF states."""


@dataclass(frozen=True)
class _Linear:
    radiance: np.ndarray
    coverage: np.ndarray


def photograph_name(index: int) -> str:
    """Name without suffix, "IMG_0001" for the first."""
    return f"IMG_{index + 1:04d}"


def write_photographs(
    out: Path, rendered: Path, recipe: PhotoRecipe, more: Mapping[str, Any]
) -> None:
    """Makes the capture folder from linear renders; it appears whole or not at all.

    Args:
        out: folder to make; must be missing or empty.
        rendered: finished folder of `render.render_missing`.
        recipe: of the capture.
        more: further entries of scene.json.
    """
    scene = json.loads((rendered / "scene.json").read_text(encoding="utf-8"))
    views = [_read(file) for file in sorted((rendered / "shots").glob("r_*.exr"))]
    taken = _taken(views, scene, rendered, recipe)
    out.parent.mkdir(parents=True, exist_ok=True)
    partial = out.with_name(f".{out.name}.{os.getpid()}")
    try:
        (partial / "truth" / "test").mkdir(parents=True)
        (partial / "truth" / "relit").mkdir()
        _write_pictures(partial, views, taken, recipe)
        _write_masks(partial, views, recipe)
        poses = np.array(scene.pop("poses"))
        _write_cameras(partial, poses, np.array(scene["scene_centre"]), rendered, recipe)
        tests = scene.pop("tests")
        for index in tests:
            for kind in ("test", "relit"):
                source = rendered / kind / f"{view_name(index)}.exr"
                shutil.copyfile(source, partial / "truth" / kind / f"{photograph_name(index)}.exr")
        write_json(partial / "truth" / CAMERAS, _true_cameras(recipe.frame, poses, tests))
        for name in ("environment.exr", "mesh.ply", SECOND_LIGHT):
            shutil.copyfile(rendered / name, partial / "truth" / name)
        write_json(partial / "truth" / "scene.json", scene | _facts(recipe, taken) | more)
        partial.replace(out)
    finally:
        shutil.rmtree(partial, ignore_errors=True)


def _read(file: Path) -> _Linear:
    with OpenEXR.File(str(file), separate_channels=True) as opened:
        planes = {name: np.asarray(c.pixels, np.float32) for name, c in opened.channels().items()}
    radiance = np.stack([planes[f"radiance.{axis}"] for axis in "RGB"], axis=-1)
    return _Linear(radiance, planes["mask"])


def _taken(
    views: list[_Linear], scene: Mapping[str, Any], rendered: Path, recipe: PhotoRecipe
) -> list[Shot]:
    """How each photograph is taken; white is the light on a level surface at the thing."""
    with OpenEXR.File(str(rendered / "environment.exr")) as opened:
        environment = np.asarray(opened.channels()["RGB"].pixels, dtype=np.float64)
    light = irradiance(environment, UP)
    for lamp in scene["lamps"]:
        light = light + np.array(lamp["irradiance_rgb"]) * max(lamp["direction"][2], 0.0)
    return shots([v.radiance for v in views], [v.coverage for v in views], light, recipe.developing)


def _write_pictures(
    out: Path, views: list[_Linear], taken: list[Shot], recipe: PhotoRecipe
) -> None:
    (out / "images").mkdir()
    developing, frame = recipe.developing, recipe.frame
    for index, (view, shot) in enumerate(zip(views, taken, strict=True)):
        shown = display(view.radiance, shot, developing, frame, developing.seed + index)
        Image.fromarray(codes_from_display(shown)).save(
            out / "images" / f"{photograph_name(index)}.jpg",
            quality=developing.quality,
            subsampling="4:2:0",
            exif=_exif(recipe, shot) if developing.has_exif else b"",
        )


def _exif(recipe: PhotoRecipe, shot: Shot) -> bytes:
    """What a camera writes: maker, speed, exposure time, focal length."""
    frame = recipe.frame
    exif = Image.Exif()
    exif[0x010F], exif[0x0110] = "Drawn", f"Camera {recipe.seed}"
    diagonal = float(np.hypot(frame.width, frame.height))
    small = frame.focal / diagonal * _SMALL_FORMAT_DIAGONAL
    exif.get_ifd(0x8769).update(
        {
            0x829A: 2.0**shot.exposure / 60.0,
            0x8827: round(recipe.developing.iso),
            0x920A: small / 6.0,
            0xA405: round(small),
        }
    )
    return exif.tobytes()


def _mask_name(recipe: PhotoRecipe, index: int) -> str:
    """COLMAP appends a suffix, others replace it."""
    between = ".jpg" if recipe.handover.layout == "colmap" else ""
    return f"{photograph_name(index)}{between}.png"


def _write_masks(out: Path, views: list[_Linear], recipe: PhotoRecipe) -> None:
    handover = recipe.handover
    if handover.masks == "none":
        return
    (out / "masks").mkdir()
    for index, view in enumerate(views):
        if handover.masks == "given":
            drawn = mask(view.coverage)
        else:
            drawn = wavy_mask(view.coverage, handover.growth, handover.seed + index)
        Image.fromarray(drawn).save(out / "masks" / _mask_name(recipe, index))


def _write_cameras(
    out: Path, poses: np.ndarray, centre: np.ndarray, rendered: Path, recipe: PhotoRecipe
) -> None:
    """What the user has of the cameras, right or not."""
    handover, frame = recipe.handover, recipe.frame
    if handover.layout == "photographs":
        return
    points = np.concatenate(
        [np.load(f, allow_pickle=False) for f in sorted((rendered / "points").glob("*.npy"))]
    )
    focal = frame.focal
    if handover.poses == "errors":
        focal *= 1.0 + handover.errors.focal
        rng = np.random.default_rng(handover.seed + 1)
        away = np.linalg.norm(points - centre, axis=1, keepdims=True)
        points = points + handover.errors.distance * (1.0 + away) * rng.normal(size=points.shape)
        poses = erroneous(poses, frame, centre, handover.errors, handover.seed)
        is_upright = handover.layout == "transforms.json"
        poses, points = placed(poses, points, handover.seed + 2, is_upright=is_upright)
    if handover.layout == "colmap":
        _write_colmap(out / "sparse" / "0", poses, points, frame, focal)
        return
    frames = []
    for index, pose in enumerate(poses):
        path = f"images/{photograph_name(index)}.jpg"
        entry = {"file_path": path, "transform_matrix": pose.tolist()}
        if handover.masks != "none":
            entry["mask_path"] = f"masks/{_mask_name(recipe, index)}"
        frames.append(entry)
    lens = {"camera_model": "OPENCV", **_lens(frame, focal)}
    write_json(out / "transforms.json", {**lens, "frames": frames})


def _lens(frame: Frame, focal: float) -> dict[str, Any]:
    middle = {"cx": 0.5 * frame.width, "cy": 0.5 * frame.height}
    return {"w": frame.width, "h": frame.height, "fl_x": focal, "fl_y": focal, **middle}


def _true_cameras(frame: Frame, poses: np.ndarray, tests: list[int]) -> dict[str, Any]:
    """Every photograph's, in the frame of the truth, and which have the whole truth."""
    return _lens(frame, frame.focal) | {
        "photographs": [
            {
                "name": photograph_name(index),
                "camera_to_world": pose.tolist(),
                "has_truth": index in tests,
            }
            for index, pose in enumerate(poses)
        ]
    }


def _write_colmap(
    folder: Path, poses: np.ndarray, points: np.ndarray, frame: Frame, focal: float
) -> None:
    """A sparse model as text, without observations."""
    folder.mkdir(parents=True)
    size = f"{frame.width} {frame.height}"
    middle = f"{0.5 * frame.width!r} {0.5 * frame.height!r}"
    (folder / "cameras.txt").write_text(
        f"# Camera list\n1 PINHOLE {size} {focal!r} {focal!r} {middle}\n", encoding="utf-8"
    )
    lines = ["# Image list with two lines of data per image"]
    for index, pose in enumerate(poses):
        world_to_camera = np.linalg.inv(pose @ _OPENCV)
        x, y, z, w = Rotation.from_matrix(world_to_camera[:3, :3]).as_quat()
        numbers = " ".join(repr(float(v)) for v in (w, x, y, z, *world_to_camera[:3, 3]))
        lines += [f"{index + 1} {numbers} 1 {photograph_name(index)}.jpg", ""]
    (folder / "images.txt").write_text("\n".join(lines) + "\n", encoding="utf-8")
    rows = [
        f"{number} {float(x)!r} {float(y)!r} {float(z)!r} 128 128 128 0.5"
        for number, (x, y, z) in enumerate(points, 1)
    ]
    (folder / "points3D.txt").write_text(
        "\n".join(["# 3D point list", *rows]) + "\n", encoding="utf-8"
    )


def _facts(recipe: PhotoRecipe, taken: list[Shot]) -> dict[str, Any]:
    """The part of scene.json that the camera decides."""
    balance = np.mean([shot.white_balance for shot in taken], axis=0)
    return {
        "view_transform": RESPONSE,
        "response": list(recipe.developing.response),
        "exposure": float(np.mean([shot.exposure for shot in taken])),
        "white_balance": balance.tolist(),
        "look": None,
        "backdrop": "photograph",
        "photographs": [
            {
                "name": photograph_name(index),
                "exposure": shot.exposure,
                "white_balance": list(shot.white_balance),
            }
            for index, shot in enumerate(taken)
        ],
    }
