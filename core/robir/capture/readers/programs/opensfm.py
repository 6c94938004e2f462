# SPDX-License-Identifier: Apache-2.0
"""OpenSfM and OpenDroneMap: reconstruction.json.

A shot holds the rotation (axis times angle) and translation from world to camera with OpenCV axes.
Image points are counted from the middle of the picture in lengths of its longer side, which scales
focal lengths too (doc/source/geometry.rst; `normalized_image_coordinates` of opensfm/features.py
puts pixel centres at half integers). A shot of a rig has the pose of its own camera.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from scipy.spatial.transform import Rotation

from robir.capture.frames import Array, Distortion, FrameSet, Lens
from robir.capture.readers.files import head, load_json
from robir.capture.readers.shots import Shot, Vector, frame_set, opencv_view, sane_points
from robir.capture.readers.values import Number, Positive, Side, checked
from robir.capture.refusal import note, refuse

FORMAT = "opensfm"
NAME = "reconstruction.json"

_CURE = "Take reconstruction.json from the folder opensfm of the project."
# radial terms of each projection that is read (`camera_from_json` of opensfm/io.py)
_TERMS = {
    "perspective": 2,
    "simple_radial": 1,
    "radial": 2,
    "brown": 3,
    "fisheye": 2,
    "fisheye_opencv": 4,
}


class _Camera(msgspec.Struct):
    width: Side
    height: Side
    projection_type: str = "perspective"
    focal: Positive | None = None
    focal_x: Positive | None = None
    focal_y: Positive | None = None
    c_x: Number = 0.0
    c_y: Number = 0.0
    k1: Number = 0.0
    k2: Number = 0.0
    k3: Number = 0.0
    k4: Number = 0.0
    p1: Number = 0.0
    p2: Number = 0.0


class _Shot(msgspec.Struct):
    rotation: Vector
    camera: str
    translation: Vector = msgspec.field(default_factory=lambda: [0.0, 0.0, 0.0])


class _Reconstruction(msgspec.Struct):
    cameras: dict[str, _Camera]
    shots: dict[str, _Shot]
    points: Any = None


def looks_like(path: Path) -> bool:
    """Whether a file is a list of reconstructions."""
    start = head(path).lstrip()
    return start.startswith("[") and '"projection_type"' in start


def read(path: Path) -> FrameSet:
    """Read the largest reconstruction."""
    parts: list[_Reconstruction] = checked(path, load_json(path), list[_Reconstruction], _CURE)
    largest = max(parts, key=lambda part: len(part.shots), default=_Reconstruction({}, {}))
    findings = []
    if len(parts) > 1:
        counts = ", ".join(str(len(part.shots)) for part in parts)
        message = f"{path.name} holds reconstructions of {counts} photographs; the largest is used"
        findings.append(note("several-models", message))
    shots = [_shot(path, largest, name, shot) for name, shot in largest.shots.items()]
    points = largest.points.values() if isinstance(largest.points, dict) else ()
    places = sane_points([p.get("coordinates") if isinstance(p, dict) else None for p in points])
    return frame_set(path, FORMAT, shots, points=places, findings=findings)


def _shot(path: Path, part: _Reconstruction, name: str, shot: _Shot) -> Shot:
    camera = part.cameras.get(shot.camera)
    if camera is None:
        raise refuse("bad-value", f"{path}: the camera of {name} is missing", _CURE, path.name)
    with np.errstate(all="ignore"):
        turn = Rotation.from_rotvec(shot.rotation).as_matrix()
    return Shot(name=name, lens=_lens(path, camera), pose=opencv_view(turn, shot.translation))


def _lens(path: Path, camera: _Camera) -> Lens:
    fx = camera.focal if camera.focal_x is None else camera.focal_x
    kind = camera.projection_type
    if kind not in _TERMS:
        message = f"{path}: the camera model {kind} is not supported"
        cure = "Undistort the photographs with `opensfm undistort` and take the reconstruction "
        cure += "there."
        raise refuse("camera-model", message, cure, path.name)
    if fx is None:
        raise refuse("bad-intrinsics", f"{path}: a camera has no focal length", _CURE, path.name)
    longer = max(camera.width, camera.height)
    radial: Array = np.array([camera.k1, camera.k2, camera.k3, camera.k4])
    radial[_TERMS[kind] :] = 0.0
    return Lens(
        width=camera.width,
        height=camera.height,
        fx=fx * longer,
        fy=(fx if camera.focal_y is None else camera.focal_y) * longer,
        cx=0.5 * camera.width + camera.c_x * longer,
        cy=0.5 * camera.height + camera.c_y * longer,
        distortion=Distortion(
            radial=tuple(radial.tolist()),
            tangential=(camera.p1, camera.p2) if kind == "brown" else (0.0, 0.0),
            is_fisheye=kind.startswith("fisheye"),
        ),
    )
