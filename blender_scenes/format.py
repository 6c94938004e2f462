# SPDX-License-Identifier: GPL-3.0-or-later
"""The capture on disk, version 1: a NeRF-synthetic folder with linear ground truth beside it.

    OUT/
      transforms_train.json transforms_test.json
      train/r_000.png ... test/r_000.png ...
      truth/scene.json environment.exr mesh.ply
      truth/train/r_000.exr ... truth/test/r_000.exr ...

`transforms_*.json`: `camera_angle_x` (full horizontal angle, radians), `w`, `h`, `fl_x`, `fl_y`,
`cx`, `cy` (pixels; the principal point is the picture's middle, pixel centres lie at
half-integers) and `frames`, each with `file_path` ("./train/r_000", no suffix) and
`transform_matrix`: 4 x 4 camera_to_world, OpenGL axes (x right, y up, the camera looks along -z),
world z up, scene units.

`*.png`: 8-bit RGBA, straight alpha. Alpha is the coverage of the pixel. RGB is round(255
clip(T(radiance 2^exposure), 0, 1)) with T the view transform for an sRGB display and `radiance`
that of the truth file; 0 where the coverage is 0. With a `backdrop` the picture is RGB, mixed with
black or white by the coverage. A `look` of Blender's comes before the view transform.

`truth/scene.json`: `format_version`, `scene`, `ground`, `light`, `preset`, `view_transform`,
`exposure` (stops), `look`, `backdrop` (null, "black" or "white"), `seed`, `resolution`, `samples`,
`views`, `test_views`, `hdri` and `asset` (file names or null), `fingerprint` (of everything that
decides the linear pixels), `blender` (version of the wheel), `sun_direction` (unit, world, towards
the sun; with a sun in the map the centroid of its brightest spot), `sun_irradiance_rgb` (of a
surface facing the sun, linear Rec.709, from the lamp or integrated over the spot), `sun_is_lamp`,
`sun_share` (of the sun in the irradiance of a surface that faces it), `lamps` (`direction`,
`irradiance_rgb` and `size` in degrees of each), `scene_centre` (middle of the bounding box),
`scene_radius` (of the sphere about it that holds all geometry), scene units. Captures of a
population also have their `classes` and `recipe`.

`truth/environment.exr`: lat-long, 2:1, linear Rec.709 radiance as rendered (turned and scaled),
without the lamp, in Blender's world frame: u = 0.5 - atan2(y, x) / 2 pi from the left, v = 0.5 -
asin(z) / pi from the top.

`truth/relit/r_*.exr` and `truth/second_light.exr`, where there are any: radiance and mask of the
test views under another map, which is laid out like environment.exr, without any lamps.

`truth/mesh.ply`: all render geometry, triangles, world frame.

`truth/*/r_*.exr`, one part, scan lines, first row at the top, straight values (not multiplied by
alpha):

| channels           | type  | meaning                                                          |
|--------------------|-------|------------------------------------------------------------------|
| radiance.R/G/B     | float | linear Rec.709, denoised path tracing, before exposure           |
| albedo.R/G/B       | half  | base colour, linear Rec.709 (of a metal: its reflectance)        |
| roughness metallic | half  | of the Principled shader, 0..1; mean over the covered part       |
| normal.X/Y/Z       | half  | unit, world frame, smooth shading included; 0 where uncovered    |
| position.X/Y/Z     | float | world position at the pixel's centre; 0 where `hit` is 0         |
| mask               | half  | coverage of the pixel, 0..1                                      |
| hit                | half  | 1 where the ray through the pixel's centre meets the scene       |
| sun_visibility     | half  | 1 where `position` faces the sun's centre and nothing is between |

Photographs (`population --photographs`) are laid out as users bring them:

    OUT/
      images/IMG_0001.jpg ...
      masks/IMG_0001.png ...              (where given; IMG_0001.jpg.png beside a COLMAP model)
      transforms.json or sparse/0/*.txt   (where poses are known)
      truth/scene.json cameras.json environment.exr mesh.ply second_light.exr
      truth/test/IMG_0005.exr ... truth/relit/IMG_0005.exr ...

`truth/cameras.json`: `w`, `h`, `fl_x`, `fl_y`, `cx`, `cy` as above, and `photographs`: `name`,
`camera_to_world` in the frame of the truth, `has_truth`. Poses with errors stand in another frame.
The truth is of the thing alone, the table is none of it: `mask`, `hit`, albedo, roughness,
metallic, normal and position are 0 elsewhere, `mesh.ply` and `scene_radius` are the thing's.
`radiance` is the whole picture's. `environment.exr` is what is seen from the thing's middle with
the thing taken away, table and room included, without lamps that are distant. `relit` shows the
thing alone. In scene.json `view_transform` is "camera response", with the `response`'s three
numbers (see `photographs.response`), and of each of the `photographs` the `exposure` (stops) and
the `white_balance` (factors on red, green and blue before the response); at the top their means.
"""

import json
import os
import shutil
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import OpenEXR
from PIL import Image

from blender_scenes.view_transform import codes_from_display, display_from_linear

FORMAT_VERSION = 1
SPLITS = ("train", "test")
SECOND_LIGHT = "second_light.exr"

_AXES = {"radiance": "RGB", "albedo": "RGB", "normal": "XYZ", "position": "XYZ"}
_FULL_FLOAT = ("radiance", "position")


@dataclass(frozen=True)
class ViewTruth:
    """Ground truth of one view; see the module's table. Arrays are (H, W) or (H, W, 3)."""

    radiance: np.ndarray
    albedo: np.ndarray
    roughness: np.ndarray
    metallic: np.ndarray
    normal: np.ndarray
    position: np.ndarray
    mask: np.ndarray
    hit: np.ndarray
    sun_visibility: np.ndarray


@dataclass(frozen=True)
class ToneMapping:
    """How linear radiance becomes a picture.

    Attributes:
        view_transform: one of `view_transform.VIEW_TRANSFORMS`.
        exposure: stops.
        look: None or the name of a look of Blender's, put before the view transform.
        backdrop: None for alpha, else "black" or "white".
    """

    view_transform: str
    exposure: float = 0.0
    look: str | None = None
    backdrop: str | None = None


def write_view(file: Path, view: ViewTruth) -> None:
    """Writes a truth EXR, whole or not at all."""
    channels = {}
    for field in fields(view):
        values = getattr(view, field.name).astype(
            np.float32 if field.name in _FULL_FLOAT else np.float16
        )
        if field.name in _AXES:
            for index, axis in enumerate(_AXES[field.name]):
                channels[f"{field.name}.{axis}"] = np.ascontiguousarray(values[..., index])
        else:
            channels[field.name] = np.ascontiguousarray(values)
    _write_exr(file, channels)


def read_view(file: Path) -> ViewTruth:
    """Reads a truth EXR, all channels as float32."""
    with OpenEXR.File(str(file), separate_channels=True) as opened:
        channels = {
            name: np.asarray(c.pixels, dtype=np.float32) for name, c in opened.channels().items()
        }
    values = {}
    for field in fields(ViewTruth):
        axes = _AXES.get(field.name)
        values[field.name] = (
            np.stack([channels[f"{field.name}.{axis}"] for axis in axes], axis=-1)
            if axes
            else channels[field.name]
        )
    return ViewTruth(**values)


def write_relit(file: Path, radiance: np.ndarray, mask: np.ndarray) -> None:
    """Writes radiance (H, W, 3) and coverage (H, W) of a view under another light as an EXR."""
    values = radiance.astype(np.float32)
    channels = {f"radiance.{a}": np.ascontiguousarray(values[..., i]) for i, a in enumerate("RGB")}
    _write_exr(file, channels | {"mask": np.ascontiguousarray(mask, dtype=np.float16)})


def write_environment(file: Path, environment: np.ndarray) -> None:
    """Writes a lat-long map (H, 2H, 3) as a float EXR, whole or not at all."""
    values = environment.astype(np.float32)
    _write_exr(file, {name: np.ascontiguousarray(values[..., i]) for i, name in enumerate("RGB")})


def write_json(file: Path, value: dict) -> None:
    """Writes JSON, whole or not at all."""
    temporary = file.with_name(f".{file.name}.{os.getpid()}")
    temporary.write_text(json.dumps(value, indent=1) + "\n", encoding="utf-8")
    temporary.replace(file)


def transforms(poses: np.ndarray, split: str, angle_x: float, resolution: int) -> dict:
    """Content of a transforms file.

    Args:
        poses: (V, 4, 4) camera_to_world, OpenGL axes.
        split: "train" or "test".
        angle_x: full horizontal angle, radians.
        resolution: width and height in pixels.

    Returns:
        What `transforms_<split>.json` holds.
    """
    focal = 0.5 * resolution / float(np.tan(0.5 * angle_x))
    middle = 0.5 * resolution
    return {
        "camera_angle_x": angle_x,
        "w": resolution,
        "h": resolution,
        "fl_x": focal,
        "fl_y": focal,
        "cx": middle,
        "cy": middle,
        "frames": [
            {"file_path": f"./{split}/{view_name(i)}", "transform_matrix": pose.tolist()}
            for i, pose in enumerate(poses)
        ],
    }


def view_name(index: int) -> str:
    """File name of a view without suffix, "r_000" for the first."""
    return f"r_{index:03d}"


def picture(view: ViewTruth, tone: ToneMapping) -> np.ndarray:
    """The 8-bit picture of a view: (H, W, 4) with straight alpha, or (H, W, 3) on a backdrop."""
    display = display_from_linear(view.radiance, tone.view_transform, tone.exposure, tone.look)
    display[view.mask <= 0.0] = 0.0
    alpha = np.clip(view.mask, 0.0, 1.0)[..., None]
    if tone.backdrop is not None:
        return codes_from_display(display * alpha + (tone.backdrop == "white") * (1.0 - alpha))
    return codes_from_display(np.concatenate([display, alpha], axis=-1))


def write_capture(
    out: Path, rendered: Path, tone: ToneMapping, more: Mapping[str, Any] = MappingProxyType({})
) -> None:
    """Makes the capture folder from linear renders; it appears whole or not at all.

    Args:
        out: folder to make; must be missing or empty.
        rendered: finished folder of linear renders: what `truth` holds, plus the transforms files.
        tone: how to make pictures of them.
        more: further entries of scene.json.
    """
    scene = json.loads((rendered / "scene.json").read_text(encoding="utf-8"))
    out.parent.mkdir(parents=True, exist_ok=True)
    partial = out.with_name(f".{out.name}.{os.getpid()}")
    try:
        for split in SPLITS:
            (partial / split).mkdir(parents=True)
            (partial / "truth" / split).mkdir(parents=True)
            for source in sorted((rendered / split).glob("r_*.exr")):
                shutil.copyfile(source, partial / "truth" / split / source.name)
                codes = picture(read_view(source), tone)
                Image.fromarray(codes).save(partial / split / f"{source.stem}.png")
            shutil.copyfile(
                rendered / f"transforms_{split}.json", partial / f"transforms_{split}.json"
            )
        for name in ("environment.exr", "mesh.ply"):
            shutil.copyfile(rendered / name, partial / "truth" / name)
        if (rendered / "relit").is_dir():
            shutil.copytree(rendered / "relit", partial / "truth" / "relit")
            shutil.copyfile(rendered / SECOND_LIGHT, partial / "truth" / SECOND_LIGHT)
        write_json(partial / "truth" / "scene.json", scene | capture_facts(tone) | more)
        partial.replace(out)
    finally:
        shutil.rmtree(partial, ignore_errors=True)


def capture_facts(tone: ToneMapping) -> dict:
    """The part of scene.json that the tone mapping decides."""
    return asdict(tone)


def _write_exr(file: Path, channels: dict[str, np.ndarray]) -> None:
    temporary = file.with_name(f".{os.getpid()}.{file.name}")
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, channels).write(str(temporary))
    temporary.replace(file)
