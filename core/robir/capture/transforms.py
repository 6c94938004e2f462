# SPDX-License-Identifier: Apache-2.0
"""Entries of transforms JSON files, shared by NeRF-synthetic, nerfstudio and instant-ngp.

Poses are camera-to-world with OpenGL axes, which is our own convention, and stay in the frame of
the file: `applied_transform`, `scale` and `offset`, which trainers use, are not applied.
"""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np

from robir.capture.frames import IMAGE_SUFFIXES, MAX_NUMBER, Array, Distortion, Lens
from robir.capture.refusal import CaptureRefusedError, refuse

PINHOLE_MODELS = frozenset(
    {"OPENCV", "PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL", "PERSPECTIVE"}
)
"""Camera models whose parameters are fl_x, fl_y, cx, cy, k1..k4, p1, p2."""

_OTHER_PROJECTIONS = (
    "is_fisheye",
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
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as fault:
        raise refuse(
            "bad-transforms",
            f"{path} is not readable as JSON ({fault})",
            "Write the file again.",
            path.name,
        ) from None
    frames = content.get("frames") if isinstance(content, dict) else None
    if not isinstance(frames, list) or not all(isinstance(entry, dict) for entry in frames):
        raise missing_key(path, "frames", "the file")
    return content


def looks_like(path: Path) -> bool:
    """Whether a file is JSON with frames, or claims to be by its name."""
    if not path.is_file() or path.suffix.lower() != ".json":
        return False
    if path.stem.lower().startswith("transforms"):
        return True
    with path.open(encoding="utf-8", errors="replace") as file:
        return '"transform_matrix"' in file.read(65536)


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
            not a pinhole with Brown-Conrady distortion.
    """
    _refuse_other_projections(path, content, entry, where)

    def number(key: str) -> float | None:
        value = entry.get(key, content.get(key))
        if value is None:
            return None
        good = isinstance(value, int | float) and not isinstance(value, bool)
        if not good or not abs(value) < MAX_NUMBER:
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
    width, height = positive("w"), positive("h")
    k1, k2, k3, k4 = (number(f"k{i}") or 0.0 for i in range(1, 5))
    return Lens(
        width=None if width is None else int(width),
        height=None if height is None else int(height),
        fx=fx,
        fy=positive("fl_y"),
        cx=number("cx"),
        cy=number("cy"),
        angle_x=angle_x,
        angle_y=positive("camera_angle_y"),
        distortion=Distortion(
            radial=(k1, k2, k3, k4), tangential=(number("p1") or 0.0, number("p2") or 0.0)
        ),
    )


def _refuse_other_projections(
    path: Path, content: dict[str, Any], entry: dict[str, Any], where: str
) -> None:
    model = str(entry.get("camera_model", content.get("camera_model", "OPENCV"))).upper()
    found = next((k for k in _OTHER_PROJECTIONS if entry.get(k, content.get(k))), None)
    if model not in PINHOLE_MODELS or found:
        raise refuse(
            "camera-model",
            f"{path}: the camera model of {where} is {found or model}, which is not supported",
            "Undistort the photographs to a pinhole camera (for example with "
            "`colmap image_undistorter`) and give that folder.",
            path.name,
        )
