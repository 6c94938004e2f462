# SPDX-License-Identifier: Apache-2.0
"""Cameras in JSON: NeRF-synthetic, nerfstudio and instant-ngp, and Polycam's keyframes.

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

Polycam's raw data are keyframes with one JSON file a camera: fx, fy, cx, cy, width, height and
t_00 .. t_23, the first three rows of camera-to-world. The world is ARKit's, in metres, y up
(README.md and core/capture_folder.py of PolyCam/polyform). `corrected_images` are undistorted and
`corrected_cameras` globally optimised; sessions too long for that have only `images` and `cameras`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import msgspec
import numpy as np
from msgspec import Meta

from robir.capture.capture import Finding
from robir.capture.frames import IMAGE_SUFFIXES, MAX_NUMBER, Array, Distortion, FrameSet, Lens
from robir.capture.readers.files import children, head, load_json
from robir.capture.readers.shots import Shot, frame_set, is_file, rolling_shutter
from robir.capture.readers.values import Matrix, Number, Positive, Side, checked, missing_key
from robir.capture.refusal import note, refuse, warning

SYNTHETIC, NERFSTUDIO, POLYCAM = "nerf-synthetic", "nerfstudio", "polycam"
TRAIN, NAME = "transforms_train.json", "transforms.json"

_CURE = "Write it as NeRF-synthetic or nerfstudio do."
_POLYCAM_CURE = "Export the raw data from Polycam again, or remove this file and its photograph."
_RATIONAL_MODEL = "FULL_OPENCV"
_FISHEYE_MODELS = frozenset(
    {"OPENCV_FISHEYE", "FISHEYE", "SIMPLE_FISHEYE", "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE"}
)
# camera models whose parameters are fl_x, fl_y, cx, cy, k1..k6, p1, p2
_MODELS = _FISHEYE_MODELS | {"OPENCV", "PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL"}
_MODELS |= {"PERSPECTIVE", _RATIONAL_MODEL}
_OTHER_PROJECTIONS = ("equirectangular", "latlong", "orthographic", "ftheta_p0")
_TESTS = ("test", "val", "eval")
_PARAMETERS = ("k1", "k2", "k3", "k4", "p1", "p2", "k5", "k6")
_APPLIED = ("applied_transform", "applied_scale")
_KEYFRAMES = "keyframes"
_PAIRS = (("corrected_cameras", "corrected_images"), ("cameras", "images"))


class Optics(msgspec.Struct):
    """What a frame, or the file for all frames, says about lens and camera; None where nothing."""

    w: Annotated[float, Meta(ge=1, le=1 << 20)] | None = None
    h: Annotated[float, Meta(ge=1, le=1 << 20)] | None = None
    fl_x: Positive | None = None
    fl_y: Positive | None = None
    cx: Number | None = None
    cy: Number | None = None
    camera_angle_x: Positive | None = None
    camera_angle_y: Positive | None = None
    k1: Number | None = None
    k2: Number | None = None
    k3: Number | None = None
    k4: Number | None = None
    k5: Number | None = None
    k6: Number | None = None
    p1: Number | None = None
    p2: Number | None = None
    distortion_params: Annotated[list[Number], Meta(max_length=6)] | None = None
    camera_model: str | None = None
    is_fisheye: bool | None = None
    rolling_shutter: Any = None
    equirectangular: Any = None
    latlong: Any = None
    orthographic: Any = None
    ftheta_p0: Any = None


class Entry(Optics):
    """One frame."""

    file_path: str | None = None
    transform_matrix: Matrix | None = None
    mask_path: str | None = None
    is_bad: bool = False
    split: str | None = None


class Transforms(Optics, kw_only=True):
    """A whole file."""

    frames: list[Entry]
    test_frames: list[Entry] = []
    applied_transform: Matrix | None = None
    applied_scale: float | None = None
    test_filenames: list[str] | None = None
    val_filenames: list[str] | None = None


def looks_like(path: Path) -> bool:
    """Whether a JSON file has frames, or claims to have by its name."""
    return path.stem.lower().startswith("transforms") or '"transform_matrix"' in head(path)


def read_synthetic(root: Path) -> FrameSet:
    """Read a NeRF-synthetic folder; test views come from the test file, else the val file.

    A test file whose photographs are all absent holds cameras to be rendered, as BlenderNeRF writes
    it, and is left out.
    """
    path = root / TRAIN
    shots, findings = _shots(path, _load(path))
    tests = [root / name for name in ("transforms_test.json", "transforms_val.json")]
    for test in [path for path in tests if path.is_file()][:1]:
        held, about = _shots(test, _load(test))
        has_photographs = any(map(is_file, _images(root, held)))
        if has_photographs or not any(map(is_file, _images(root, shots))):
            shots += [replace(shot, split="test") for shot in held]
            findings += about
        else:
            message = f"{test.name} holds {len(held)} cameras without photographs; it is left out"
            findings.append(note("poses-only", message))
    return frame_set(path, SYNTHETIC, shots, images=_images(root, shots), findings=findings)


def read(path: Path) -> FrameSet:
    """Read poses, intrinsics, masks and splits of nerfstudio or instant-ngp.

    Poses are in the frame from before `applied_transform`.
    """
    content = _load(path)
    undo = _undoing(path, content)
    shots, findings = _shots(path, content)
    shots = [replace(shot, pose=undo(shot.pose)) for shot in shots]
    without = [shot.name for shot in shots if shot.mask is None]
    if 0 < len(without) < len(shots):
        message = f'{path}: {len(without)} of {len(shots)} frames have no "mask_path"'
        cure = "Name a mask for every frame, or give all masks with --masks DIR."
        raise refuse("missing-masks", message, cure, *without)
    applied = [key for key in _APPLIED if getattr(content, key) is not None]
    if applied:
        message = f"{path.name} holds {' and '.join(applied)}; poses were taken back to the frame "
        findings.append(note("applied-transform", message + "and unit from before"))
    if content.rolling_shutter or any(entry.rolling_shutter for entry in content.frames):
        findings.append(rolling_shutter(path))
    images = _images(path.parent, shots)
    return frame_set(path, NERFSTUDIO, shots, images=images, findings=findings)


def _load(path: Path) -> Transforms:
    """A transforms file, or a refusal if it has no frames or holds something else in them."""
    content = load_json(path)
    frames = content.get("frames") if isinstance(content, dict) else None
    if not isinstance(frames, list):
        raise missing_key(path, "frames", "the file", _CURE)
    return checked(path, content, Transforms, _CURE)


def _shots(path: Path, content: Transforms) -> tuple[list[Shot], list[Finding]]:
    """Cameras of a file, and findings about those it marks as bad, which are left out."""
    names = [*(content.test_filenames or ()), *(content.val_filenames or ())]
    tests = {name.removeprefix("./") for name in names}
    found, bad = [], []
    for index, entry in enumerate([*content.frames, *content.test_frames]):
        if entry.file_path is None or not entry.file_path.strip():
            raise missing_key(path, "file_path", f"frame {index}", _CURE)
        relative = entry.file_path.replace("\\", "/").removeprefix("./")
        where = f"frame {index} ({relative})"
        is_test = index >= len(content.frames) or relative in tests or entry.split in _TESTS
        if entry.is_bad:
            bad.append(relative)
            continue
        found.append(
            Shot(
                name=relative,
                lens=_lens(path, content, entry, where),
                pose=_pose(path, entry, where),
                mask=entry.mask_path,
                split="test" if is_test else "train",
            )
        )
    message = f"{len(bad)} photographs are left out, as {path.name} marks them as bad"
    return found, [note("bad-frames", message, *bad)] if bad else []


def _images(root: Path, shots: Sequence[Shot]) -> list[Path]:
    """Where photographs lie; NeRF-synthetic leaves the suffix away. Each folder is listed once."""
    listed: dict[Path, frozenset[str]] = {}
    found = []
    for plain in (root / shot.name for shot in shots):
        if plain.parent not in listed:
            listed[plain.parent] = frozenset(path.name for path in children(plain.parent))
        names = [plain.name] if plain.name.lower().endswith(IMAGE_SUFFIXES) else []
        names += [f"{plain.name}{end}" for s in IMAGE_SUFFIXES for end in (s, s.upper())]
        there = next((name for name in names if name in listed[plain.parent]), None)
        usual = plain.name if plain.suffix else f"{plain.name}.png"
        found.append(plain.parent / (there or usual))
    return found


def _pose(path: Path, entry: Entry, where: str) -> Array:
    """A frame's camera-to-world matrix, (4, 4), whatever its numbers are worth."""
    rows = entry.transform_matrix
    if rows is None:
        raise missing_key(path, "transform_matrix", where, _CURE)
    if len(rows) not in (3, 4) or any(len(row) != 4 for row in rows):
        message = f'{path}: "transform_matrix" of {where} is no 4x4 matrix of numbers'
        raise refuse("bad-pose", message, "Write four rows of four numbers.", path.name)
    return np.array([*rows[:3], [0.0, 0.0, 0.0, 1.0]])


def _lens(path: Path, content: Transforms, entry: Entry, where: str) -> Lens:
    """A frame's intrinsics: its own keys, else those of the file."""
    stated: dict[str, Any] = {}
    for key in Optics.__struct_fields__:
        own, common = getattr(entry, key), getattr(content, key)
        if own is not None or common is not None:
            stated[key] = common if own is None else own
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
    width, height = stated.get("w"), stated.get("h")
    k1, k2, k3, k4, p1, p2, k5, k6 = (stated.get(key, 0.0) for key in _PARAMETERS)
    is_fisheye = model in _FISHEYE_MODELS
    bent = Distortion(radial=(k1, k2, k3, k4), tangential=(p1, p2), is_fisheye=is_fisheye)
    if k5 or k6 or model == _RATIONAL_MODEL:
        bent = Distortion(radial=(k1, k2, k3, 0.0), rational=(k4, k5, k6), tangential=(p1, p2))
    return Lens(
        width=None if width is None else int(width),
        height=None if height is None else int(height),
        fx=fx,
        fy=stated.get("fl_y"),
        cx=stated.get("cx"),
        cy=stated.get("cy"),
        angle_x=angle_x,
        angle_y=stated.get("camera_angle_y"),
        distortion=bent,
    )


def _undoing(path: Path, content: Transforms) -> Callable[[Array], Array]:
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
        original = np.eye(4)
        with np.errstate(invalid="ignore", over="ignore"):  # poses without finite numbers go later
            original[:3, :3] = turn.T @ pose[:3, :3] / size
            original[:3, 3] = turn.T @ (pose[:3, 3] / scale - applied[:3, 3]) / size**2
        return original

    return undo


def find_keyframes(source: Path) -> Path | None:
    """Polycam's folder of keyframes in or directly below a folder, told by its camera files."""
    if not source.is_dir():
        return None
    for place in (source, source / _KEYFRAMES):
        if _pair(place) is not None:
            return place
    # Newer exports wrap everything in one more folder.
    nested = [child / _KEYFRAMES for child in children(source) if _pair(child / _KEYFRAMES)]
    return nested[0] if len(nested) == 1 else None


def _pair(folder: Path) -> tuple[str, str] | None:
    """Names of the folders of cameras and photographs, the optimised ones first."""
    for cameras, images in _PAIRS:
        if (folder / images).is_dir():
            first = next((p for p in children(folder / cameras) if p.suffix == ".json"), None)
            if first is not None and '"t_00"' in head(first):
                return cameras, images
    return None


def read_keyframes(folder: Path) -> FrameSet:
    """Read Polycam's poses and intrinsics, the optimised ones if they are there."""
    pair = _pair(folder)
    assert pair is not None
    cameras, images = (folder / name for name in pair)
    pictures = {p.stem: p for p in children(images) if p.suffix.lower() in IMAGE_SUFFIXES}
    files = {p.stem: p for p in children(cameras) if p.suffix == ".json"}
    both = [stem for stem in files if stem in pictures]
    shots = [_keyframe(files[stem], f"{images.name}/{pictures[stem].name}") for stem in both]
    findings = []
    alone = [path.name for stem, path in files.items() if stem not in pictures]
    if alone:
        message = f"{len(alone)} camera files have no photograph"
        findings.append(note("unused-cameras", message, *alone))
    if pair == _PAIRS[1]:
        message = f"{folder} has no corrected_images and corrected_cameras: poses are as the phone "
        message += "tracked them, and the photographs keep their lens distortion"
        cure = "Process the session again with loop closure on and export the raw data again."
        findings.append(warning("raw-poses", message, cure))
    found = [pictures[stem] for stem in both]
    return frame_set(cameras, POLYCAM, shots, images=found, findings=findings)


_SIDES = [("width", Side), ("height", Side)]
_NUMBERS = [("fx", Positive), ("fy", Positive), ("cx", Number), ("cy", Number)]
_ROWS = [[f"t_{row}{column}" for column in range(4)] for row in range(3)]
_POSE = [(key, float) for row in _ROWS for key in row]
_Camera = msgspec.defstruct("_Camera", [*_SIDES, *_NUMBERS, *_POSE])  # a camera file


def _keyframe(path: Path, name: str) -> Shot:
    camera: Any = checked(path, load_json(path), _Camera, _POLYCAM_CURE, code="bad-camera")
    pose = np.eye(4)
    pose[:3] = [[getattr(camera, key) for key in row] for row in _ROWS]
    lens = Lens(**{key: getattr(camera, key) for key, _ in (*_SIDES, *_NUMBERS)}, is_scalable=True)
    return Shot(name=name, lens=lens, pose=pose)
