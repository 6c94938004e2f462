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
from pathlib import Path
from typing import Any

import numpy as np

from robir.capture.files import head, is_number, load_json
from robir.capture.frames import IMAGE_SUFFIXES, Array, Distortion, Lens
from robir.capture.refusal import CaptureRefusedError, refuse

_RATIONAL_MODEL = "FULL_OPENCV"
_FISHEYE_MODELS = frozenset(
    {"OPENCV_FISHEYE", "FISHEYE", "SIMPLE_FISHEYE", "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE"}
)
_MODELS = _FISHEYE_MODELS | {
    "OPENCV",
    "PINHOLE",
    "SIMPLE_PINHOLE",
    "SIMPLE_RADIAL",
    "RADIAL",
    "PERSPECTIVE",
    _RATIONAL_MODEL,
}
"""Camera models whose parameters are fl_x, fl_y, cx, cy, k1..k6, p1, p2."""

_OTHER_PROJECTIONS = (
    "equirectangular",
    "latlong",
    "orthographic",
    "ftheta_p0",
)


def load(path: Path) -> dict[str, Any]:
    """Read a transforms file and check that it is one.

    Args:
        path: JSON file.

    Returns:
        Its content, with a list of dictionaries under "frames".

    Raises:
        CaptureError: If it is no JSON or has no frames.
    """
    content = load_json(path)
    frames = content.get("frames") if isinstance(content, dict) else None
    if not isinstance(frames, list) or not all(isinstance(entry, dict) for entry in frames):
        raise missing_key(path, "frames", "the file")
    return content


def looks_like(path: Path) -> bool:
    """Whether a JSON file has frames, or claims to have by its name."""
    return path.stem.lower().startswith("transforms") or '"transform_matrix"' in head(path)


def missing_key(path: Path, key: str, where: str) -> CaptureRefusedError:
    """The refusal for a key that is not there."""
    return refuse(
        "missing-key",
        f'{path}: the key "{key}" is missing from {where}',
        f'Add "{key}" as NeRF-synthetic or nerfstudio write it.',
        path.name,
    )


def file_path(path: Path, entry: dict[str, Any], index: int) -> str:
    """Path of a frame's photograph as written, "./" dropped."""
    value = entry.get("file_path")
    if not isinstance(value, str) or not value.strip():
        raise missing_key(path, "file_path", f"frame {index}")
    value = value.replace("\\", "/")
    return value[2:] if value.startswith("./") else value


def image_at(root: Path, relative: str) -> Path:
    """The photograph a path means; NeRF-synthetic leaves the suffix away."""
    plain = root / relative
    if plain.suffix.lower() in IMAGE_SUFFIXES and plain.is_file():
        return plain
    for suffix in IMAGE_SUFFIXES:
        for spelling in (suffix, suffix.upper()):
            candidate = plain.with_name(plain.name + spelling)
            if candidate.is_file():
                return candidate
    return plain if plain.suffix else plain.with_name(plain.name + ".png")


def pose(path: Path, entry: dict[str, Any], where: str) -> Array:
    """A frame's camera-to-world matrix, (4, 4), whatever its numbers are worth."""
    if "transform_matrix" not in entry:
        raise missing_key(path, "transform_matrix", where)
    try:
        matrix = np.array(entry["transform_matrix"], dtype=np.float64)
    except (TypeError, ValueError):
        matrix = np.zeros(0)
    if matrix.shape not in ((4, 4), (3, 4)):
        raise refuse(
            "bad-pose",
            f'{path}: "transform_matrix" of {where} is no 4x4 matrix of numbers',
            "Write four rows of four numbers.",
            path.name,
        )
    return np.vstack([matrix[:3], [0.0, 0.0, 0.0, 1.0]])


def lens(path: Path, content: dict[str, Any], entry: dict[str, Any], where: str) -> Lens:
    """A frame's intrinsics: its own keys, else those of the file.

    Raises:
        CaptureError: If there is no focal length, a number is no number, or the projection is
            neither a pinhole nor an equidistant fisheye.
    """
    stated = content | entry
    model = _camera_model(path, stated, where)

    def number(key: str) -> float | None:
        value = stated.get(key)
        if value is None:
            return None
        if not is_number(value):
            raise refuse(
                "bad-intrinsics",
                f'{path}: "{key}" of {where} is {value!r}, not a finite number',
                "Write a number.",
                path.name,
            )
        return float(value)

    def positive(key: str) -> float | None:
        value = number(key)
        if value is not None and value <= 0:
            raise refuse(
                "bad-intrinsics",
                f'{path}: "{key}" of {where} is {value:g}; it must be positive',
                "Correct it.",
                path.name,
            )
        return value

    fx, angle_x = positive("fl_x"), positive("camera_angle_x")
    if fx is None and (angle_x is None or angle_x >= math.pi):
        raise missing_key(path, "fl_x (or camera_angle_x)", f"{where} and from the file")
    if "distortion_params" in stated:
        stated |= _listed_parameters(path, stated["distortion_params"], where)
    width, height = positive("w"), positive("h")
    return Lens(
        width=None if width is None else int(width),
        height=None if height is None else int(height),
        fx=fx,
        fy=positive("fl_y"),
        cx=number("cx"),
        cy=number("cy"),
        angle_x=angle_x,
        angle_y=positive("camera_angle_y"),
        distortion=_distortion(model, {k: number(k) or 0.0 for k in _PARAMETERS}),
    )


_PARAMETERS = ("k1", "k2", "k3", "k4", "p1", "p2", "k5", "k6")


def _distortion(model: str, found: dict[str, float]) -> Distortion:
    k1, k2, k3, k4, p1, p2, k5, k6 = (found[key] for key in _PARAMETERS)
    if k5 or k6 or model == _RATIONAL_MODEL:
        return Distortion(radial=(k1, k2, k3, 0.0), rational=(k4, k5, k6), tangential=(p1, p2))
    return Distortion(
        radial=(k1, k2, k3, k4), tangential=(p1, p2), is_fisheye=model in _FISHEYE_MODELS
    )


def _listed_parameters(path: Path, values: object, where: str) -> dict[str, float]:
    if not isinstance(values, list) or len(values) > 6 or not all(map(is_number, values)):
        raise refuse(
            "bad-intrinsics",
            f'{path}: "distortion_params" of {where} is {values!r}, not six numbers',
            "Write k1, k2, k3, k4, p1, p2.",
            path.name,
        )
    return dict(zip(_PARAMETERS, values, strict=False))


def _camera_model(path: Path, stated: dict[str, Any], where: str) -> str:
    """Name of the camera model, or a refusal of other projections."""
    model = str(stated.get("camera_model", "OPENCV")).upper()
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
