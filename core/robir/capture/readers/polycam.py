# SPDX-License-Identifier: Apache-2.0
"""Polycam's raw data: keyframes with one JSON file a camera.

A camera file holds fx, fy, cx, cy, width, height and t_00 .. t_23, the first three rows of
camera-to-world. Axes are ARKit's, which are OpenGL's and ours; the world is ARKit's, in metres, y
up (README.md and core/capture_folder.py of PolyCam/polyform). Poses stay in that world, although
`raw.glb` beside it was turned by "alignmentTransform". Principal points count from the corner of
the picture (Apple, `ARCamera.intrinsics`).

`corrected_images` are undistorted and `corrected_cameras` globally optimised; sessions too long for
that have only `images` and `cameras`.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from robir.capture.frames import IMAGE_SUFFIXES, FrameSet, Lens
from robir.capture.readers.files import children, head, load_json
from robir.capture.readers.shots import Shot, frame_set
from robir.capture.readers.values import Number, Positive, Side, checked
from robir.capture.refusal import note, warning

FORMAT = "polycam"

_FOLDER = "keyframes"
_CURE = "Export the raw data from Polycam again, or remove this file and its photograph."
_PAIRS = (("corrected_cameras", "corrected_images"), ("cameras", "images"))


def find(source: Path) -> Path | None:
    """The folder of keyframes in or directly below a folder, told by its camera files."""
    if not source.is_dir():
        return None
    for place in (source, source / _FOLDER):
        if _pair(place) is not None:
            return place
    # Newer exports wrap everything in one more folder.
    nested = [child / _FOLDER for child in children(source) if _pair(child / _FOLDER)]
    return nested[0] if len(nested) == 1 else None


def read(folder: Path) -> FrameSet:
    """Read poses and intrinsics, the optimised ones if they are there.

    Args:
        folder: The folder of keyframes.

    Returns:
        Frames in ARKit's world.

    Raises:
        CaptureError: If a camera file is damaged or incomplete.
    """
    pair = _pair(folder)
    assert pair is not None
    cameras, images = (folder / name for name in pair)
    pictures = {
        path.stem: path for path in children(images) if path.suffix.lower() in IMAGE_SUFFIXES
    }
    files = {path.stem: path for path in _camera_files(cameras)}
    both = [stem for stem in files if stem in pictures]
    shots = [_shot(files[stem], f"{images.name}/{pictures[stem].name}") for stem in both]
    findings = []
    alone = [path.name for stem, path in files.items() if stem not in pictures]
    if alone:
        findings.append(
            note("unused-cameras", f"{len(alone)} camera files have no photograph", *alone)
        )
    if pair == _PAIRS[1]:
        findings.append(
            warning(
                "raw-poses",
                f"{folder} has no corrected_images and corrected_cameras: poses are as the phone "
                "tracked them, and the photographs keep their lens distortion",
                "Process the session again with loop closure on and export the raw data again.",
            )
        )
    found = [pictures[stem] for stem in both]
    return frame_set(cameras, FORMAT, shots, images=found, findings=findings)


def _pair(folder: Path) -> tuple[str, str] | None:
    """Names of the folders of cameras and photographs, the optimised ones first."""
    for cameras, images in _PAIRS:
        if (folder / images).is_dir():
            first = next(iter(_camera_files(folder / cameras)), None)
            if first is not None and '"t_00"' in head(first):
                return cameras, images
    return None


def _camera_files(folder: Path) -> list[Path]:
    return [path for path in children(folder) if path.suffix == ".json"]


_SIDES = [("width", Side), ("height", Side)]
_NUMBERS = [("fx", Positive), ("fy", Positive), ("cx", Number), ("cy", Number)]
_ROWS = [[f"t_{row}{column}" for column in range(4)] for row in range(3)]
_POSE = [(key, float) for row in _ROWS for key in row]
_Camera = msgspec.defstruct("_Camera", [*_SIDES, *_NUMBERS, *_POSE])  # a camera file


def _shot(path: Path, name: str) -> Shot:
    camera: Any = checked(path, load_json(path), _Camera, _CURE, code="bad-camera")
    pose = np.eye(4)
    pose[:3] = [[getattr(camera, key) for key in row] for row in _ROWS]
    lens = Lens(**{key: getattr(camera, key) for key, _ in (*_SIDES, *_NUMBERS)}, is_scalable=True)
    return Shot(name=name, lens=lens, pose=pose)
