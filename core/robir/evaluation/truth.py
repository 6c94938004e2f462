# SPDX-License-Identifier: Apache-2.0
"""Reads the ground truth beside a capture; `blender_scenes/format.py` documents the files."""

from __future__ import annotations

import math
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
import trimesh
from numpy.typing import NDArray
from PIL import Image

from robir.capture.camera import Camera
from robir.capture.images.decode import MAX_FILE_BYTES
from robir.capture.images.regular import regular
from robir.errors import CaptureError
from robir.jobs.records import MATRIX, NUMBERS, read_record
from robir.maths.tone_power import DISPLAY_POWER

Array = NDArray[np.float32]

_FORMAT_VERSION = 1

_SCENE = {
    "format_version": int, "scene": Any, "ground": Any, "light": Any, "seed": Any,
    "view_transform": str, "look?": (None, str), "exposure?": float, f"{DISPLAY_POWER}?": float,
    "sun_direction": NUMBERS, "scene_radius": float, "sun_is_lamp?": bool,
    "sun_irradiance_rgb?": NUMBERS,
    "lamps?": [{"direction": NUMBERS, "irradiance_rgb": NUMBERS}],
}  # fmt: skip
_TEST_VIEWS = {
    "w": int, "h": int, "fl_x": float, "fl_y": float, "cx": float, "cy": float,
    "frames": [{"file_path": str, "transform_matrix": MATRIX}],
}  # fmt: skip

_MAX_NUMBERS = 400_000_000
"""Largest EXR file, over all channels; a sky of 8192 columns has a quarter of it."""

_DAMAGE = (OSError, ValueError, LookupError, RuntimeError, TypeError, AttributeError, EOFError)
"""What reading a damaged truth raises."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TrueView:
    """What is known of one view; images are (H, W) or (H, W, 3) float32, row 0 on top.

    Attributes:
        name: File name of the view without suffix, "r_000".
        camera: Its camera, capture frame.
        photo_display: Photograph in [0, 1], display-referred, straight.
        albedo: Linear Rec.709.
        roughness: Perceptual, 0..1.
        normal: Unit, world; 0 in the background.
        position: World position of the surface at the pixel's centre.
        hit: Bool, whether the pixel-centre ray meets the scene: the foreground.
        sun_visibility: 1 where the surface faces the sun and sees it.
    """

    name: str
    camera: Camera
    photo_display: Array
    albedo: Array
    roughness: Array
    normal: Array
    position: Array
    hit: NDArray[np.bool_]
    sun_visibility: Array


@dataclass(frozen=True, slots=True, kw_only=True)
class Truth:
    """Ground truth of a rendered capture, in the capture's own frame and unit.

    Attributes:
        root: The capture folder.
        scene: Contents of truth/scene.json.
        views: Test views.
        environment_linear: (H, 2H, 3) lat-long radiance, with each lamp as one bright texel.
        sun_direction: (3,) unit, towards the sun.
        vertices: (Nv, 3) of all render geometry.
        faces: (Nf, 3).
        radius: Radius of the scene.
    """

    root: Path
    scene: dict[str, Any]
    views: tuple[TrueView, ...]
    environment_linear: Array
    sun_direction: NDArray[np.float64]
    vertices: Array
    faces: NDArray[np.int32]
    radius: float

    @property
    def exposed(self) -> float:
        """Factor that brings true radiance to what the tone curve was given."""
        return 2.0 ** float(self.scene.get("exposure", 0.0))


def has_truth(capture: Path) -> bool:
    """Whether a capture was rendered with its truth beside it."""
    return (capture / "truth" / "scene.json").is_file()


def load_truth(capture: Path) -> Truth:
    """Read the truth of a capture's test views.

    Args:
        capture: Folder that holds transforms_test.json and truth/.

    Raises:
        CaptureError: If there is no truth or it cannot be read.
    """
    folder = capture / "truth"
    if not (folder / "scene.json").is_file():
        raise CaptureError(
            f"{capture} holds no truth/scene.json: only captures made by `python -m "
            "blender_scenes` can be evaluated against truth"
        )
    try:
        scene = _scene(folder / "scene.json")
        with regular(folder / "mesh.ply", MAX_FILE_BYTES) as file:
            mesh = trimesh.load_mesh(BytesIO(file.read()), file_type="ply", process=False)
        return Truth(
            root=capture,
            scene=scene,
            views=_test_views(capture),
            environment_linear=_environment(folder / "environment.exr", scene),
            sun_direction=np.array(scene["sun_direction"]),
            vertices=np.asarray(mesh.vertices, np.float32),
            faces=np.asarray(mesh.faces, np.int32),
            radius=float(scene["scene_radius"]),
        )
    except _DAMAGE as fault:
        raise CaptureError(
            f"the truth in {folder} cannot be read ({fault}); render the capture again"
        ) from fault


def _scene(path: Path) -> dict[str, Any]:
    scene = read_record(path, _SCENE)
    if scene["format_version"] != _FORMAT_VERSION:
        raise ValueError(f"format version {scene['format_version']}, not {_FORMAT_VERSION}")
    return scene


def _test_views(capture: Path) -> tuple[TrueView, ...]:
    table = read_record(capture / "transforms_test.json", _TEST_VIEWS)
    views = []
    for frame in table["frames"]:
        name = Path(frame["file_path"]).name
        camera = Camera(
            width=table["w"],
            height=table["h"],
            fx=table["fl_x"],
            fy=table["fl_y"],
            cx=table["cx"],
            cy=table["cy"],
            camera_to_world=np.array(frame["transform_matrix"], np.float64),
        )
        image = read_exr(capture / "truth" / "test" / f"{name}.exr")
        with (
            regular(capture / "test" / f"{name}.png") as file,
            Image.open(file, formats=["PNG"]) as picture,
        ):
            photo = np.asarray(picture.convert("RGBA"), np.float32)[..., :3] / 255.0
        size = (camera.height, camera.width)
        if {photo.shape[:2], *(channel.shape for channel in image.values())} != {size}:
            raise ValueError(f"the pictures of {name} are not of the same size as its camera")
        views.append(
            TrueView(
                name=name,
                camera=camera,
                photo_display=photo,
                albedo=_triple(image, "albedo", "RGB"),
                roughness=image["roughness"],
                normal=_triple(image, "normal", "XYZ"),
                position=_triple(image, "position", "XYZ"),
                hit=image["hit"] > 0.5,
                sun_visibility=image["sun_visibility"],
            )
        )
    return tuple(views)


class TooLargeError(ValueError):
    """A picture has more numbers than are read."""


def read_exr(path: Path, most: int = _MAX_NUMBERS) -> dict[str, Array]:
    """All channels of an EXR file's first part by name, (H, W) float32 each.

    Raises:
        TooLargeError: If they have more numbers than `most` together.
    """
    with regular(path, MAX_FILE_BYTES), OpenEXR.File(str(path), header_only=True) as opened:
        header = opened.header()
        low, high = header["dataWindow"]
        sides = [int(last) - int(first) + 1 for first, last in zip(low, high, strict=True)]
        if math.prod(sides) * len(header["channels"]) > most:
            raise TooLargeError(f"it has {sides[0]} by {sides[1]} pixels")
    with OpenEXR.File(str(path), separate_channels=True) as opened:
        return {name: np.asarray(c.pixels, np.float32) for name, c in opened.channels().items()}


def _triple(image: dict[str, Array], name: str, axes: str) -> Array:
    return np.stack([image[f"{name}.{axis}"] for axis in axes], axis=-1)


def _environment(path: Path, scene: dict[str, Any]) -> Array:
    """The map as rendered; a lamp's irradiance is put into the texel of its direction."""
    image = read_exr(path)
    linear = np.stack([image[axis] for axis in "RGB"], axis=-1)
    rows, columns = linear.shape[:2]
    for direction, irradiance_rgb in lamps_of(scene):
        x, y, z = direction
        u = (0.5 - np.arctan2(y, x) / (2 * np.pi)) % 1.0
        row = min(int((0.5 - np.arcsin(z) / np.pi) * rows), rows - 1)
        top, bottom = (np.sin(np.pi * (0.5 - r / rows)) for r in (row, row + 1))
        solid_angle = (top - bottom) * 2 * np.pi / columns
        column = min(int(u * columns), columns - 1)
        linear[row, column] += np.array(irradiance_rgb) / solid_angle
    return linear


def lamps_of(scene: dict[str, Any]) -> list[tuple[list[float], list[float]]]:
    """Direction and irradiance of each lamp; older captures tell of the strongest alone."""
    if "lamps" in scene:
        return [(lamp["direction"], lamp["irradiance_rgb"]) for lamp in scene["lamps"]]
    is_lamp = scene["sun_is_lamp"]
    return [(scene["sun_direction"], scene["sun_irradiance_rgb"])] if is_lamp else []
