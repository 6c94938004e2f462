# SPDX-License-Identifier: Apache-2.0
"""OpenMVG: sfm_data.json, as cereal writes it.

Poses hold the rotation from world to camera with OpenCV axes, row by row, and the centre. Pixel
centres lie at integers (undistortion samples at whole pixels), so half a pixel is added to the
principal point, as for AliceVision, which grew from it. Distortion is that of
src/openMVG/cameras: k1 to k3, and T1 and T2 of Brown's model are OpenCV's p1 and p2.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import msgspec
from msgspec import Meta

from robir.capture.frames import Distortion, FrameSet, Lens
from robir.capture.readers.files import head, load_json
from robir.capture.readers.shots import Shot, Vector, frame_set, opencv_pose, sane_points
from robir.capture.readers.values import Number, Positive, Side, checked
from robir.capture.refusal import note, refuse

FORMAT = "openmvg"

_CURE = "Write it again: openMVG_main_ConvertSfM_DataFormat -i sfm_data.bin -o sfm_data.json."
_Terms = Annotated[list[Number], Meta(max_length=8)]


class _View(msgspec.Struct):
    filename: str
    id_intrinsic: int
    id_pose: int
    local_path: str = ""


class _Intrinsic(msgspec.Struct):
    width: Side
    height: Side
    focal_length: Positive
    principal_point: Annotated[list[Number], Meta(min_length=2, max_length=2)]
    disto_k1: _Terms = []
    disto_k3: _Terms = []
    disto_t2: _Terms = []
    fisheye: _Terms = []


class _Pose(msgspec.Struct):
    rotation: Annotated[list[Vector], Meta(min_length=3, max_length=3)]
    center: Vector


class _File(msgspec.Struct):
    views: list[dict[str, Any]]
    intrinsics: list[dict[str, Any]]
    extrinsics: list[dict[str, Any]]
    structure: Any = None


def looks_like(path: Path) -> bool:
    """Whether a file says which version of the format it has."""
    return '"sfm_data_version"' in head(path, 4096)


def read(path: Path) -> FrameSet:
    """Read views that have a pose, and the sparse points."""
    content: _File = checked(path, load_json(path), _File, _CURE)
    poses = {key: checked(path, value, _Pose, _CURE) for key, value in _pairs(content.extrinsics)}
    lenses = {key: _lens(path, value) for key, value in _pairs(content.intrinsics)}
    shots, without = [], []
    for _, value in _pairs(content.views):
        view: _View = checked(path, _pointed(value), _View, _CURE)
        name = f"{view.local_path}/{view.filename}".lstrip("/")
        pose = poses.get(str(view.id_pose))
        if pose is None:
            without.append(name)
        elif str(view.id_intrinsic) not in lenses:
            raise refuse("bad-value", f"{path}: {name} has no intrinsics", _CURE, path.name)
        else:
            turn = [list(column) for column in zip(*pose.rotation, strict=True)]
            place = opencv_pose(turn, pose.center)
            shots.append(Shot(name=name, lens=lenses[str(view.id_intrinsic)], pose=place))
    findings = []
    if without and shots:
        message = f"{len(without)} of {len(content.views)} views of {path.name} have no pose"
        findings.append(note("unposed-views", message, *without))
    points = sane_points([_at(value, "X") for _, value in _pairs(content.structure)])
    return frame_set(path, FORMAT, shots, points=points, findings=findings)


def _pairs(entries: Any) -> list[tuple[Any, Any]]:
    """Keys and values of one of cereal's maps."""
    entries = entries if isinstance(entries, list) else []
    return [(str(_at(entry, "key")), _at(entry, "value")) for entry in entries]


def _pointed(value: Any) -> Any:
    """What one of cereal's pointers points to."""
    return _at(_at(value, "ptr_wrapper"), "data")


def _at(table: Any, key: str) -> Any:
    return table.get(key) if isinstance(table, dict) else None


def _lens(path: Path, value: Any) -> Lens:
    kind, plain = str(_at(value, "polymorphic_name")), _pointed(value)
    if kind.startswith("spherical"):
        message = f"{path}: the camera model {kind} is not supported"
        cure = "Undistort the photographs with openMVG_main_ExportUndistortedImages."
        raise refuse("camera-model", message, cure, path.name)
    base = _at(plain, "value0")  # some lenses hold their pinhole in it
    plain = {**base, **plain} if isinstance(base, dict) else plain
    camera: _Intrinsic = checked(path, plain, _Intrinsic, _CURE)
    terms = camera.disto_t2[:3] or camera.disto_k3 or camera.disto_k1 or camera.fisheye
    k1, k2, k3, k4 = (*terms, 0.0, 0.0, 0.0, 0.0)[:4]
    t1, t2 = (*camera.disto_t2[3:], 0.0, 0.0)[:2]
    is_fisheye = bool(camera.fisheye)
    bent = Distortion(radial=(k1, k2, k3, k4), tangential=(t1, t2), is_fisheye=is_fisheye)
    cx, cy = (value + 0.5 for value in camera.principal_point)
    lens = Lens(width=camera.width, height=camera.height, fx=camera.focal_length)
    return replace(lens, cx=cx, cy=cy, distortion=bent)
