# SPDX-License-Identifier: Apache-2.0
"""Cameras in JSON: NeRF-synthetic, nerfstudio, instant-ngp; sdfstudio, splats, NeRFactor, TensoIR.

Poses are camera-to-world with OpenGL axes, which is our own convention, and pixel centres lie at
half integers (nerfstudio, cameras.py: `get_image_coords`).

Lens parameters follow nerfstudio's `get_distortion_params`: k1..k4 are the polynomial, p1 and p2
the tangential part, "distortion_params" is the list (k1, k2, k3, k4, p1, p2). A file that holds k5
or k6, or names FULL_OPENCV, means OpenCV's rational model, where k4, k5 and k6 stand below the
line. With OPENCV_FISHEYE (instant-ngp: "is_fisheye") the polynomial is one of the angle.

nerfstudio's converters turn and scale the world of the program that found the poses and say so:
with A the 3x4 "applied_transform" and s the "applied_scale", a point p of that program lies at
s A (p, 1) in the file (nerfstudio_dataparser.py: `transform_matrix @ applied_transform`,
`scale_factor *= applied_scale`). Both are undone here, so that the result stands where the
capture's own point cloud does. What trainers apply on loading ("scale", "offset", "aabb_scale",
"orientation_override") has not been applied to the file's poses and is left alone.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import msgspec
import numpy as np
from msgspec import Meta

from robir.capture.capture import Finding
from robir.capture.frames import IMAGE_SUFFIXES, MAX_NUMBER, Array, Distortion, FrameSet, Lens
from robir.capture.readers.files import (
    Matrix,
    Number,
    Positive,
    Side,
    Sixteen,
    Turn,
    Vector,
    checked,
    children,
    head,
    load_json,
    matrix_of,
    missing_key,
)
from robir.capture.readers.shots import (
    Shot,
    frame_set,
    is_file,
    opencv_pose,
    opengl_pose,
    rolling_shutter,
)
from robir.capture.refusal import note, refuse, some

SYNTHETIC = "nerf-synthetic"
TRAIN, NAME = "transforms_train.json", "transforms.json"

_CURE = "Write it as NeRF-synthetic or nerfstudio do."
_RATIONAL_MODEL = "FULL_OPENCV"
_FISHEYE_MODELS = frozenset(
    {"OPENCV_FISHEYE", "FISHEYE", "SIMPLE_FISHEYE", "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE"}
)
# camera models whose parameters are fl_x, fl_y, cx, cy, k1..k6, p1, p2
_MODELS = _FISHEYE_MODELS | {"OPENCV", "PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL"}
_MODELS |= {"PERSPECTIVE", _RATIONAL_MODEL}
_OTHER_PROJECTIONS = ("equirectangular", "latlong", "orthographic", "ftheta_p0")
_PARAMETERS = ("k1", "k2", "k3", "k4", "p1", "p2", "k5", "k6")
_KINDS: dict[Any, tuple[str, ...]] = {
    Annotated[float, Meta(ge=1, le=1 << 20)]: ("w", "h"),
    Positive: ("fl_x", "fl_y", "camera_angle_x", "camera_angle_y"),
    Number: ("cx", "cy", *_PARAMETERS),
    Annotated[list[Number], Meta(max_length=6)]: ("distortion_params",),
    str: ("camera_model",),
    bool: ("is_fisheye",),
    Any: (*_OTHER_PROJECTIONS, "rolling_shutter"),
}
# what a frame, or the file for all frames, says about lens and camera; None where nothing
_OPTICS = [(key, kind | None, None) for kind, keys in _KINDS.items() for key in keys]
_Entry = msgspec.defstruct(
    "_Entry",
    [
        *_OPTICS,
        ("file_path", str | None, None),
        ("transform_matrix", Matrix | None, None),
        ("mask_path", str | None, None),
        ("is_bad", bool, False),
        ("split", str | None, None),
    ],
)
_Transforms = msgspec.defstruct(
    "_Transforms",
    [
        ("frames", list[_Entry]),
        *_OPTICS,
        ("test_frames", list[_Entry], []),
        ("applied_transform", Matrix | None, None),
        ("applied_scale", float | None, None),
        ("test_filenames", list[str] | None, None),
        ("val_filenames", list[str] | None, None),
    ],
)


def looks_like(path: Path) -> bool:
    """Whether a JSON file has frames, or claims to have by its name."""
    return path.stem.lower().startswith("transforms") or '"transform_matrix"' in head(path)


def read_synthetic(root: Path) -> FrameSet:
    """A NeRF-synthetic folder; test views are of the test file, else of val, with photographs."""
    path = root / TRAIN
    shots, findings = _shots(path, _load(path))
    tests = [root / name for name in ("transforms_test.json", "transforms_val.json")]
    for test in [path for path in tests if path.is_file()][:1]:
        held_out, about = _shots(test, _load(test))
        if _are_there(held_out) or not _are_there(shots):
            shots += [replace(shot, split="test") for shot in held_out]
            findings += about
        else:
            message = f"{test.name} holds {len(held_out)} cameras without photographs: left out"
            findings.append(note("poses-only", message))
    return frame_set(path, SYNTHETIC, shots, findings)


def _are_there(shots: Sequence[Shot]) -> bool:
    return any(shot.image is not None and is_file(shot.image) for shot in shots)


def read(path: Path) -> FrameSet:
    """Poses before `applied_transform`, lenses, masks and splits of nerfstudio or instant-ngp."""
    content = _load(path)
    undo = _undoing(path, content)
    shots, findings = _shots(path, content)
    shots = [replace(shot, pose=undo(shot.pose)) for shot in shots]
    without = [shot.name for shot in shots if shot.mask is None]
    if 0 < len(without) < len(shots):
        message = f'{path}: {len(without)} of {len(shots)} frames have no "mask_path"'
        cure = "Name a mask for every frame, or give all masks with --masks DIR."
        raise refuse("missing-masks", message, cure, *without)
    keys = ("applied_transform", "applied_scale")
    applied = [key for key in keys if getattr(content, key) is not None]
    if applied:
        message = f"{path.name} holds {' and '.join(applied)}; poses were taken back to the frame "
        findings.append(note("applied-transform", message + "and unit from before"))
    if content.rolling_shutter or any(entry.rolling_shutter for entry in content.frames):
        findings.append(rolling_shutter(path))
    return frame_set(path, "nerfstudio", shots, findings)


def _load(path: Path) -> Any:
    """A transforms file, or a refusal if it has no frames or holds something else in them."""
    content = load_json(path)
    if not isinstance(content, dict) or "frames" not in content:
        raise missing_key(path, "frames", "the file", _CURE)
    return checked(path, content, _Transforms, _CURE)


def _shots(path: Path, content: Any) -> tuple[list[Shot], list[Finding]]:
    """Cameras of a file, and findings about those it marks as bad, which are left out."""
    names = (*(content.test_filenames or ()), *(content.val_filenames or ()))
    tests = {name.removeprefix("./") for name in names}
    found, bad = [], []
    listed: dict[Path, frozenset[str]] = {}
    for index, entry in enumerate([*content.frames, *content.test_frames]):
        if entry.file_path is None or not entry.file_path.strip():
            raise missing_key(path, "file_path", f"frame {index}", _CURE)
        relative = entry.file_path.replace("\\", "/").removeprefix("./")
        where = f"frame {index} ({relative})"
        is_test = relative in tests or entry.split in ("test", "val", "eval")
        if entry.is_bad:
            bad.append(relative)
            continue
        if entry.transform_matrix is None:
            raise missing_key(path, "transform_matrix", where, _CURE)
        shot = Shot(
            name=relative,
            lens=_lens(path, content, entry, where),
            pose=matrix_of(path, entry.transform_matrix, f'"transform_matrix" of {where}'),
            image=_image(path.parent / relative, listed),
            mask=entry.mask_path,
            split="test" if is_test or index >= len(content.frames) else "train",
        )
        found.append(shot)
    message = f"{len(bad)} photographs are left out, as {path.name} marks them as bad"
    return found, some("note", "bad-frames", bad, message)


def _image(plain: Path, listed: dict[Path, frozenset[str]]) -> Path:
    """Where a photograph lies, whose suffix may be left away; each folder is listed once."""
    if plain.parent not in listed:
        listed[plain.parent] = frozenset(path.name for path in children(plain.parent))
    names = [plain.name] if plain.name.lower().endswith(IMAGE_SUFFIXES) else []
    names += [f"{plain.name}{end}" for s in IMAGE_SUFFIXES for end in (s, s.upper())]
    there = next((name for name in names if name in listed[plain.parent]), None)
    return plain.parent / (there or (plain.name if plain.suffix else f"{plain.name}.png"))


def _lens(path: Path, content: Any, entry: Any, where: str) -> Lens:
    """A frame's intrinsics: its own keys, else those of the file."""
    stated = {
        key: value
        for holder in (content, entry)
        for key, *_ in _OPTICS
        if (value := getattr(holder, key)) is not None
    }
    model = stated.get("camera_model", "OPENCV").upper()
    model = "OPENCV_FISHEYE" if stated.get("is_fisheye") else model
    other = next((key for key in _OTHER_PROJECTIONS if stated.get(key)), None)
    if model not in _MODELS or other:
        message = f"{path}: the camera model of {where} is {other or model}, which is not supported"
        cure = "Undistort the photographs to a pinhole camera (for example with "
        cure += "`colmap image_undistorter`) and give that folder."
        raise refuse("camera-model", message, cure, path.name)
    fx, angle_x = stated.get("fl_x"), stated.get("camera_angle_x")
    if fx is None and (angle_x is None or angle_x >= math.pi):
        raise missing_key(path, "fl_x (or camera_angle_x)", f"{where} and from the file", _CURE)
    stated |= dict(zip(_PARAMETERS, stated.get("distortion_params", ()), strict=False))
    k1, k2, k3, k4, p1, p2, k5, k6 = (stated.get(key, 0.0) for key in _PARAMETERS)
    is_fisheye = model in _FISHEYE_MODELS
    bent = Distortion(radial=(k1, k2, k3, k4), tangential=(p1, p2), is_fisheye=is_fisheye)
    if k5 or k6 or model == _RATIONAL_MODEL:
        bent = Distortion(radial=(k1, k2, k3, 0.0), rational=(k4, k5, k6), tangential=(p1, p2))
    keys = {"fy": "fl_y", "cx": "cx", "cy": "cy", "angle_y": "camera_angle_y"}
    found: dict[str, Any] = {name: stated.get(key) for name, key in keys.items()}
    width, height = (int(stated[key]) if key in stated else None for key in ("w", "h"))
    return Lens(width=width, height=height, fx=fx, angle_x=angle_x, **found, distortion=bent)


def _undoing(path: Path, content: Any) -> Callable[[Array], Array]:
    """What takes a camera-to-world matrix of the file back to the frame before the transform."""
    scale = 1.0 if content.applied_scale is None else content.applied_scale
    rows = np.eye(4).tolist() if content.applied_transform is None else content.applied_transform
    is_matrix = len(rows) in (3, 4) and all(len(row) == 4 for row in rows)
    applied = np.array(rows if is_matrix else np.zeros((4, 4)), dtype=np.float64)
    is_sane = bool((np.abs(applied) < MAX_NUMBER).all()) and 0 < scale < MAX_NUMBER
    turn = applied[:3, :3] if is_sane else np.zeros((3, 3))
    size = float(np.cbrt(np.linalg.det(turn)))
    good = size > 1e-9 and np.allclose(turn @ turn.T, size * size * np.eye(3), atol=1e-4 * size**2)
    if not good:
        message = f'{path}: "applied_transform" and "applied_scale" do not turn, scale and move '
        cure = "Write a 3x4 matrix without shear or mirror, and a positive number; or leave both "
        cure += "out to keep the poses as the file gives them."
        raise refuse("bad-transform", message + "space", cure, path.name)

    def undo(pose: Array) -> Array:
        with np.errstate(invalid="ignore", over="ignore"):  # poses without finite numbers go later
            place = turn.T @ (pose[:3, 3] / scale - applied[:3, 3]) / size**2
            return opengl_pose(turn.T @ pose[:3, :3] / size, place)

    return undo


# sdfstudio: meta_data.json. "camtoworld" has OpenCV axes, "intrinsics" is a matrix in pixels
# (nerfstudio, sdfstudio_dataparser.py). Poses stay in the file's own frame, which "worldtogt" would
# carry into that of the data set they were made from.

_SDF_CURE = "Write it as sdfstudio's process_data scripts do."
_SdfRow = Annotated[list[Number], Meta(min_length=3, max_length=4)]


class _SdfFrame(msgspec.Struct):
    rgb_path: str
    camtoworld: Matrix
    intrinsics: Annotated[list[_SdfRow], Meta(min_length=3, max_length=4)]
    foreground_mask: str | None = None


class _SdfFile(msgspec.Struct):
    width: Side
    height: Side
    frames: list[_SdfFrame]


def read_sdfstudio(path: Path) -> FrameSet:
    """Read poses, intrinsics and masks of sdfstudio."""
    content: _SdfFile = checked(path, load_json(path), _SdfFile, _SDF_CURE)
    shots = []
    for frame in content.frames:
        pose = matrix_of(path, frame.camtoworld, f'"camtoworld" of {frame.rgb_path[:80]}')
        (fx, skew, cx), (_, fy, cy) = frame.intrinsics[0][:3], frame.intrinsics[1][:3]
        lens = Lens(width=content.width, height=content.height, fx=fx, fy=fy, cx=cx, cy=cy)
        shot = Shot(
            name=frame.rgb_path,
            lens=replace(lens, distortion=Distortion(skew=skew / fx if fx else 0.0)),
            pose=opencv_pose(pose[:3, :3], pose[:3, 3]),
            image=path.parent / frame.rgb_path,
            mask=frame.foreground_mask,
        )
        shots.append(shot)
    return frame_set(path, "sdfstudio", shots)


# 3D Gaussian splatting: cameras.json of a training run. "rotation" is camera-to-world with OpenCV
# axes, row by row, "position" the centre; the principal point is the middle
# (graphdeco-inria/gaussian-splatting, utils/camera_utils.py: `camera_to_JSON`). Photographs lie
# elsewhere, often larger than the run used them.


class _Splat(msgspec.Struct):
    img_name: Annotated[str, Meta(min_length=1)]
    width: Side
    height: Side
    fx: Positive
    fy: Positive
    position: Vector
    rotation: Turn


def read_splats(path: Path) -> FrameSet:
    """Read poses and focal lengths of a run of 3D Gaussian splatting."""
    cure = "Take cameras.json from the output folder of the training."
    cameras: list[_Splat] = checked(path, load_json(path), list[_Splat], cure)
    shots = []
    for c in cameras:
        lens = Lens(width=c.width, height=c.height, fx=c.fx, fy=c.fy, is_scalable=True)
        shots.append(Shot(name=c.img_name, lens=lens, pose=opencv_pose(c.rotation, c.position)))
    return frame_set(path, "gaussian-splatting", shots)


# NeRFactor and TensoIR: folders train_000, train_001, ... with metadata.json and rgba.png.
# "cam_transform_mat" is camera-to-world as sixteen numbers, row by row, with Blender's axes, which
# are ours; "cam_angle_x" the horizontal field of view. TensoIR renders each view under several
# lights (rgba_sunset.png, ...): those of one light are read.

_VIEW = "metadata.json"
_VIEW_CURE = "Render the view again, or remove its folder."


class _NerfactorView(msgspec.Struct):
    cam_angle_x: Positive
    cam_transform_mat: str
    imw: Side
    imh: Side


def is_nerfactor(source: Path) -> bool:
    """Whether a folder holds views of NeRFactor."""
    first = next((child for child in children(source) if child.name.startswith("train_")), None)
    return first is not None and '"cam_transform_mat"' in head(first / _VIEW)


def read_nerfactor(source: Path) -> FrameSet:
    """Read views to learn from, and those to test with, or to validate, that have photographs."""
    train, test, val = (
        [c for c in children(source) if c.name.startswith(split) and (c / _VIEW).is_file()]
        for split in ("train_", "test_", "val_")
    )
    pictures = {
        folder: [path.name for path in children(folder) if path.name.startswith("rgba")]
        for folder in (*train, *test, *val)
    }
    counts = Counter(name for folder in train for name in pictures[folder])
    light = max(counts, key=lambda name: (counts[name], name == "rgba.png"), default="rgba.png")
    tests = next((some for some in (test, val) if any(light in pictures[f] for f in some)), [])
    shots = []
    for folder in (*train, *tests):
        path, name = folder / _VIEW, f"{folder.name}/{light}"
        view: _NerfactorView = checked(path, load_json(path), _NerfactorView, _VIEW_CURE)
        words = view.cam_transform_mat.split(",")
        row = checked(path, words, Sixteen, _VIEW_CURE, where="cam_transform_mat", is_text=True)
        lens = Lens(width=view.imw, height=view.imh, angle_x=view.cam_angle_x)
        shot = Shot(name=name, image=source / name, lens=lens, pose=np.array(row).reshape(4, 4))
        shots.append(replace(shot, split="train" if folder in train else "test"))
    others = [name for name in counts if name != light]
    message = f"Of {len(counts)} pictures a view, {light} is read: one object, one light"
    findings = some("note", "several-lights", others, message)
    return frame_set(source / _VIEW, "nerfactor", shots, findings)
