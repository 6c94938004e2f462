# SPDX-License-Identifier: Apache-2.0
"""Reads the ground truth beside a capture; `blender_scenes/format.py` documents the files."""

from __future__ import annotations

from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray
from PIL import Image
from scipy.ndimage import map_coordinates

from robir.capture.camera import Camera
from robir.capture.images.decode import MAX_FILE_BYTES
from robir.errors import CaptureError
from robir.evaluation.light import read_exr
from robir.jobs.names import regular
from robir.jobs.records import MATRIX, NUMBERS, read_record
from robir.maths.tone_curve import DISPLAY_POWER
from robir.maths.vectors import equirect_directions

Array = NDArray[np.float32]

_FORMAT_VERSION = 1

_SCENE = {
    "format_version": int, "scene": Any, "ground": Any, "light": Any, "seed": Any,
    "view_transform": str, "look?": (None, str), "exposure?": float, f"{DISPLAY_POWER}?": float,
    "sun_direction": NUMBERS, "scene_radius": float, "sun_is_lamp?": bool,
    "sun_irradiance_rgb?": NUMBERS,
    "lamps?": [{"direction": NUMBERS, "irradiance_rgb": NUMBERS}], "white_balance?": NUMBERS,
}  # fmt: skip
_TEST_VIEWS = {
    "w": int, "h": int, "fl_x": float, "fl_y": float, "cx": float, "cy": float,
    "frames": [{"file_path": str, "transform_matrix": MATRIX}],
}  # fmt: skip

_CAMERAS = {
    "w": int, "h": int, "fl_x": float, "fl_y": float, "cx": float, "cy": float,
    "photographs": [{"name": str, "camera_to_world": MATRIX, "has_truth": bool}],
}  # fmt: skip

PHOTOGRAPHED = "cameras.json"  # the photographs' true cameras, in a frame of their own
# what reading a damaged truth raises
_DAMAGE = (OSError, ValueError, LookupError, RuntimeError, TypeError, AttributeError, EOFError)


@dataclass(frozen=True, slots=True, kw_only=True)
class TrueView:
    """What is known of one view; images are (H, W) or (H, W, 3) float32, row 0 on top."""

    name: str  # file name of the view without suffix, "r_000"
    camera: Camera  # its camera, capture frame
    photo_display: Array  # photograph in [0, 1], display-referred, straight
    albedo: Array  # linear Rec.709
    roughness: Array  # perceptual, 0..1
    normal: Array  # unit, world; 0 in the background
    position: Array  # world position of the surface at the pixel's centre
    hit: NDArray[np.bool_]  # bool, whether the pixel-centre ray meets the scene: the foreground
    sun_visibility: Array  # 1 where the surface faces the sun and sees it


@dataclass(frozen=True, slots=True, kw_only=True)
class Truth:
    """Ground truth of a rendered capture, in the capture's own frame and unit."""

    root: Path  # the capture folder
    scene: dict[str, Any]  # contents of truth/scene.json
    views: tuple[TrueView, ...]  # test views
    environment_linear: Array  # (H, 2H, 3) lat-long radiance, with each lamp as one bright texel
    sun_direction: NDArray[np.float64]  # (3,) unit, towards the sun
    vertices: Array  # (Nv, 3) of all render geometry
    faces: NDArray[np.int32]  # (Nf, 3)
    radius: float  # radius of the scene
    cameras: dict[str, Camera] = field(default_factory=dict)  # of photographs, by name

    @property
    def exposed(self) -> NDArray[np.float64]:
        """Factors (3,) that bring true radiance to what the tone curve was given."""
        balance = np.array(self.scene.get("white_balance", [1.0, 1.0, 1.0]))
        return 2.0 ** float(self.scene.get("exposure", 0.0)) * balance


def has_truth(capture: Path) -> bool:
    """Whether a capture was rendered with its truth beside it."""
    return (capture / "truth" / "scene.json").is_file()


def load_truth(capture: Path) -> Truth:
    """The truth of test views, from truth/ and transforms_test.json; or a `CaptureError`."""
    folder = capture / "truth"
    if not (folder / "scene.json").is_file():
        raise CaptureError(
            f"{capture} holds no truth/scene.json: only captures made by `python -m "
            "blender_scenes` can be evaluated against truth"
        )
    try:
        scene = _scene(folder / "scene.json")
        cameras = _cameras(folder / PHOTOGRAPHED) if (folder / PHOTOGRAPHED).is_file() else {}
        with regular(folder / "mesh.ply", MAX_FILE_BYTES) as file:
            mesh = trimesh.load_mesh(BytesIO(file.read()), file_type="ply", process=False)
        return Truth(
            root=capture,
            scene=scene,
            views=_photographs(capture) if cameras else _test_views(capture),
            environment_linear=true_environment(capture, scene, np.eye(3)),
            sun_direction=np.array(scene["sun_direction"]),
            vertices=np.asarray(mesh.vertices, np.float32),
            faces=np.asarray(mesh.faces, np.int32),
            radius=float(scene["scene_radius"]),
            cameras=cameras,
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
        camera = _camera(table, frame["transform_matrix"])
        views.append(_view(capture, name, camera, capture / "test" / f"{name}.png"))
    return tuple(views)


def _photographs(capture: Path) -> tuple[TrueView, ...]:
    """The photographs that have the whole truth, in its frame."""
    table = read_record(capture / "truth" / PHOTOGRAPHED, _CAMERAS)
    return tuple(
        _view(
            capture,
            entry["name"],
            _camera(table, entry["camera_to_world"]),
            capture / "images" / f"{entry['name']}.jpg",
        )
        for entry in table["photographs"]
        if entry["has_truth"]
    )


def _cameras(path: Path) -> dict[str, Camera]:
    table = read_record(path, _CAMERAS)
    entries = table["photographs"]
    return {entry["name"]: _camera(table, entry["camera_to_world"]) for entry in entries}


def _camera(table: dict[str, Any], camera_to_world: list[list[float]]) -> Camera:
    names = {"width": "w", "height": "h", "fx": "fl_x", "fy": "fl_y", "cx": "cx", "cy": "cy"}
    lens: dict[str, Any] = {name: table[key] for name, key in names.items()}
    return Camera(**lens, camera_to_world=np.array(camera_to_world, np.float64))


def _view(capture: Path, name: str, camera: Camera, photograph: Path) -> TrueView:
    image = read_exr(capture / "truth" / "test" / f"{name}.exr")
    with (
        regular(photograph, MAX_FILE_BYTES) as file,
        Image.open(file, formats=["PNG", "JPEG"]) as picture,
    ):
        photo = np.asarray(picture.convert("RGBA"), np.float32)[..., :3] / 255.0
    size = (camera.height, camera.width)
    if {photo.shape[:2], *(channel.shape for channel in image.values())} != {size}:
        raise ValueError(f"the pictures of {name} are not of the same size as its camera")
    axes = {"albedo": "RGB", "normal": "XYZ", "position": "XYZ"}
    triples = {key: _triple(image, key, letters) for key, letters in axes.items()}
    planes = {key: image[key] for key in ("roughness", "sun_visibility")}
    known: dict[str, Any] = triples | planes | {"hit": image["hit"] > 0.5}
    return TrueView(name=name, camera=camera, photo_display=photo, **known)


def _triple(image: dict[str, Array], name: str, axes: str) -> Array:
    return np.stack([image[f"{name}.{axis}"] for axis in axes], axis=-1)


def true_environment(
    capture: Path, scene: dict[str, Any], turn: NDArray[np.floating[Any]]
) -> Array:
    """Lat-long radiance (H, 2H, 3), turned by (3, 3), a lamp in the texel of its direction."""
    image = read_exr(capture / "truth" / "environment.exr")
    linear = np.stack([image[axis] for axis in "RGB"], axis=-1)
    rows, columns = linear.shape[:2]
    if not np.allclose(turn, np.eye(3)):
        linear = _turned(linear, turn)
    for direction, irradiance_rgb in lamps_of(scene):
        u, v = _texel(turn @ np.array(direction))
        row = min(int(v * rows), rows - 1)
        top, bottom = (np.sin(np.pi * (0.5 - r / rows)) for r in (row, row + 1))
        solid_angle = (top - bottom) * 2 * np.pi / columns
        column = min(int(u * columns), columns - 1)
        linear[row, column] += np.array(irradiance_rgb) / solid_angle
    return linear


def _texel(directions: NDArray[np.floating[Any]]) -> NDArray[np.float64]:
    """Where unit directions (..., 3) lie in a lat-long map, (2, ...): shares of its sides."""
    x, y, z = np.moveaxis(directions, -1, 0)
    u = (0.5 - np.arctan2(y, x) / (2 * np.pi)) % 1.0
    return np.stack([u, 0.5 - np.arcsin(np.clip(z, -1.0, 1.0)) / np.pi])


def _turned(linear: Array, turn: NDArray[np.floating[Any]]) -> Array:
    """A lat-long map (H, 2H, 3) in a frame that a rotation (3, 3) brings its own to."""
    rows, columns = linear.shape[:2]
    u, v = _texel(equirect_directions(rows).numpy() @ turn)
    places = np.stack([v * rows - 0.5, u * columns - 0.5])
    padded = np.pad(linear, ((1, 1), (1, 1), (0, 0)), mode="wrap")
    padded[0], padded[-1] = padded[1], padded[-2]
    return np.stack(
        [map_coordinates(padded[..., c], places + 1.0, order=1, mode="nearest") for c in range(3)],
        axis=-1,
    )


def lamps_of(scene: dict[str, Any]) -> list[tuple[list[float], list[float]]]:
    """Direction and irradiance of each lamp; older captures tell of the strongest alone."""
    if "lamps" in scene:
        return [(lamp["direction"], lamp["irradiance_rgb"]) for lamp in scene["lamps"]]
    is_lamp = scene["sun_is_lamp"]
    return [(scene["sun_direction"], scene["sun_irradiance_rgb"])] if is_lamp else []
