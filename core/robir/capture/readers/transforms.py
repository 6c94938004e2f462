# SPDX-License-Identifier: Apache-2.0
"""Entries of transforms JSON files, shared by NeRF-synthetic, nerfstudio and instant-ngp.

Poses are camera-to-world with OpenGL axes, which is our own convention, and pixel centres lie at
half integers (nerfstudio, cameras.py: `get_image_coords`).

Lens parameters follow nerfstudio's `get_distortion_params`: k1..k4 are the polynomial, p1 and p2
the tangential part, "distortion_params" is the list (k1, k2, k3, k4, p1, p2). A file that holds k5
or k6, or names FULL_OPENCV, means OpenCV's rational model, where k4, k5 and k6 stand below the
line. With OPENCV_FISHEYE (instant-ngp: "is_fisheye") the polynomial is one of the angle.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import msgspec
import numpy as np
from msgspec import Meta

from robir.capture.capture import Finding
from robir.capture.frames import IMAGE_SUFFIXES, Array, Distortion, Lens
from robir.capture.readers.files import children, head, load_json
from robir.capture.readers.shots import Shot
from robir.capture.readers.values import Matrix, Number, Positive, checked, missing_key
from robir.capture.refusal import note, refuse

_CURE = "Write it as NeRF-synthetic or nerfstudio do."

_RATIONAL_MODEL = "FULL_OPENCV"
_FISHEYE_MODELS = frozenset(
    {"OPENCV_FISHEYE", "FISHEYE", "SIMPLE_FISHEYE", "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE"}
)
# camera models whose parameters are fl_x, fl_y, cx, cy, k1..k6, p1, p2
_MODELS = _FISHEYE_MODELS | {
    "OPENCV",
    "PINHOLE",
    "SIMPLE_PINHOLE",
    "SIMPLE_RADIAL",
    "RADIAL",
    "PERSPECTIVE",
    _RATIONAL_MODEL,
}
_OTHER_PROJECTIONS = ("equirectangular", "latlong", "orthographic", "ftheta_p0")

_TESTS = ("test", "val", "eval")

_PARAMETERS = ("k1", "k2", "k3", "k4", "p1", "p2", "k5", "k6")


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


def load(path: Path) -> Transforms:
    """Read a transforms file and check that it is one.

    Args:
        path: JSON file.

    Returns:
        Its content.

    Raises:
        CaptureError: If it is no JSON, has no frames, or holds something else where numbers, names
            or matrices belong.
    """
    content = load_json(path)
    frames = content.get("frames") if isinstance(content, dict) else None
    if not isinstance(frames, list):
        raise missing_key(path, "frames", "the file", _CURE)
    return checked(path, content, Transforms, _CURE)


def looks_like(path: Path) -> bool:
    """Whether a JSON file has frames, or claims to have by its name."""
    return path.stem.lower().startswith("transforms") or '"transform_matrix"' in head(path)


def file_path(path: Path, entry: Entry, index: int) -> str:
    """Path of a frame's photograph as written, "./" dropped."""
    if entry.file_path is None or not entry.file_path.strip():
        raise missing_key(path, "file_path", f"frame {index}", _CURE)
    value = entry.file_path.replace("\\", "/")
    return value[2:] if value.startswith("./") else value


def shots(path: Path, content: Transforms) -> tuple[list[Shot], list[Finding]]:
    """Cameras of a file, and findings about those it marks as bad, which are left out.

    Raises:
        CaptureError: If a key is missing or a camera is neither a pinhole nor a fisheye.
    """
    tests = {
        name.removeprefix("./")
        for names in (content.test_filenames, content.val_filenames)
        for name in names or ()
    }
    found, bad = [], []
    for index, entry in enumerate([*content.frames, *content.test_frames]):
        relative = file_path(path, entry, index)
        where = f"frame {index} ({relative})"
        is_test = index >= len(content.frames) or relative in tests or entry.split in _TESTS
        if entry.is_bad:
            bad.append(relative)
            continue
        found.append(
            Shot(
                name=relative,
                lens=lens(path, content, entry, where),
                pose=pose(path, entry, where),
                mask=entry.mask_path,
                split="test" if is_test else "train",
            )
        )
    if not bad:
        return found, []
    message = f"{len(bad)} photographs are left out, as {path.name} marks them as bad"
    return found, [note("bad-frames", message, *bad)]


def images(root: Path, shots: Sequence[Shot]) -> list[Path]:
    """Where photographs lie; NeRF-synthetic leaves the suffix away. Each folder is listed once."""
    listed: dict[Path, frozenset[str]] = {}
    found = []
    for plain in (root / shot.name for shot in shots):
        if plain.parent not in listed:
            listed[plain.parent] = frozenset(path.name for path in children(plain.parent))
        has_suffix = plain.name.lower().endswith(IMAGE_SUFFIXES)
        names = [plain.name] if has_suffix else []
        names += [f"{plain.name}{end}" for s in IMAGE_SUFFIXES for end in (s, s.upper())]
        there = next((name for name in names if name in listed[plain.parent]), None)
        found.append(
            plain.parent / (there or (plain.name if plain.suffix else f"{plain.name}.png"))
        )
    return found


def pose(path: Path, entry: Entry, where: str) -> Array:
    """A frame's camera-to-world matrix, (4, 4), whatever its numbers are worth."""
    if entry.transform_matrix is None:
        raise missing_key(path, "transform_matrix", where, _CURE)
    rows = entry.transform_matrix
    if len(rows) not in (3, 4) or any(len(row) != 4 for row in rows):
        raise refuse(
            "bad-pose",
            f'{path}: "transform_matrix" of {where} is no 4x4 matrix of numbers',
            "Write four rows of four numbers.",
            path.name,
        )
    return np.array([*rows[:3], [0.0, 0.0, 0.0, 1.0]])


def lens(path: Path, content: Transforms, entry: Entry, where: str) -> Lens:
    """A frame's intrinsics: its own keys, else those of the file.

    Raises:
        CaptureError: If there is no focal length, or the projection is neither a pinhole nor an
            equidistant fisheye.
    """
    stated: dict[str, Any] = {
        key: value
        for key in Optics.__struct_fields__
        for value in (_first(getattr(entry, key), getattr(content, key)),)
        if value is not None
    }
    model = _camera_model(path, stated, where)
    fx, angle_x = stated.get("fl_x"), stated.get("camera_angle_x")
    if fx is None and (angle_x is None or angle_x >= math.pi):
        raise missing_key(path, "fl_x (or camera_angle_x)", f"{where} and from the file", _CURE)
    stated |= dict(zip(_PARAMETERS, stated.get("distortion_params", ()), strict=False))
    width, height = stated.get("w"), stated.get("h")
    return Lens(
        width=None if width is None else int(width),
        height=None if height is None else int(height),
        fx=fx,
        fy=stated.get("fl_y"),
        cx=stated.get("cx"),
        cy=stated.get("cy"),
        angle_x=angle_x,
        angle_y=stated.get("camera_angle_y"),
        distortion=_distortion(model, {key: stated.get(key, 0.0) for key in _PARAMETERS}),
    )


def _distortion(model: str, found: dict[str, float]) -> Distortion:
    k1, k2, k3, k4, p1, p2, k5, k6 = (found[key] for key in _PARAMETERS)
    if k5 or k6 or model == _RATIONAL_MODEL:
        return Distortion(radial=(k1, k2, k3, 0.0), rational=(k4, k5, k6), tangential=(p1, p2))
    return Distortion(
        radial=(k1, k2, k3, k4), tangential=(p1, p2), is_fisheye=model in _FISHEYE_MODELS
    )


def _first(own: Any, common: Any) -> Any:
    return common if own is None else own


def _camera_model(path: Path, stated: Mapping[str, Any], where: str) -> str:
    """Name of the camera model, or a refusal of other projections."""
    model = stated.get("camera_model", "OPENCV").upper()
    if stated.get("is_fisheye"):
        model = "OPENCV_FISHEYE"
    other = next((key for key in _OTHER_PROJECTIONS if stated.get(key)), None)
    if model not in _MODELS or other:
        raise refuse(
            "camera-model",
            f"{path}: the camera model of {where} is {other or model}, which is not supported",
            "Undistort the photographs to a pinhole camera (for example with "
            "`colmap image_undistorter`) and give that folder.",
            path.name,
        )
    return model
