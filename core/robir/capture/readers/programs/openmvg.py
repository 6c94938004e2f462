# SPDX-License-Identifier: Apache-2.0
"""OpenMVG: sfm_data.json, as cereal writes it.

Poses hold the rotation from world to camera with OpenCV axes, row by row, and the centre. Pixel
centres lie at integers (undistortion samples at whole pixels), so half a pixel is added to the
principal point, as for AliceVision, which grew from it. Distortion is that of
src/openMVG/cameras: k1 to k3, and T1 and T2 of Brown's model are OpenCV's p1 and p2.
"""

from __future__ import annotations

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


class _Projection(msgspec.Struct):
    width: Side
    height: Side
    focal_length: Positive
    principal_point: Annotated[list[Number], Meta(min_length=2, max_length=2)]


class _Intrinsic(msgspec.Struct):
    value0: _Projection | None = None
    width: Side | None = None
    height: Side | None = None
    focal_length: Positive | None = None
    principal_point: Annotated[list[Number], Meta(min_length=2, max_length=2)] | None = None
    disto_k1: _Terms = []
    disto_k3: _Terms = []
    disto_t2: _Terms = []
    fisheye: _Terms = []


class _Pose(msgspec.Struct):
    rotation: Annotated[list[Vector], Meta(min_length=3, max_length=3)]
    center: Vector


class _Data(msgspec.Struct):
    data: Any


class _Pointer(msgspec.Struct):
    ptr_wrapper: _Data
    polymorphic_name: str = ""


class _Entry(msgspec.Struct):
    key: int
    value: Any


class _File(msgspec.Struct):
    views: list[_Entry]
    intrinsics: list[_Entry]
    extrinsics: list[_Entry]
    structure: Any = None


def looks_like(path: Path) -> bool:
    """Whether a file says which version of the format it has."""
    return '"sfm_data_version"' in head(path, 4096)


def read(path: Path) -> FrameSet:
    """Read views that have a pose, and the sparse points.

    Args:
        path: sfm_data.json.

    Returns:
        Frames in the frame of the file.

    Raises:
        CaptureError: If the file is damaged, holds no poses or a camera is not supported.
    """
    content: _File = checked(path, load_json(path), _File, _CURE)
    poses = {entry.key: checked(path, entry.value, _Pose, _CURE) for entry in content.extrinsics}
    lenses = {entry.key: _lens(path, entry.value) for entry in content.intrinsics}
    shots, without = [], []
    for entry in content.views:
        pointer: _Pointer = checked(path, entry.value, _Pointer, _CURE)
        view: _View = checked(path, pointer.ptr_wrapper.data, _View, _CURE)
        name = f"{view.local_path}/{view.filename}".lstrip("/")
        pose = poses.get(view.id_pose)
        if pose is None:
            without.append(name)
        elif view.id_intrinsic not in lenses:
            raise refuse("bad-value", f"{path}: {name} has no intrinsics", _CURE, path.name)
        else:
            turn = [list(column) for column in zip(*pose.rotation, strict=True)]
            place = opencv_pose(turn, pose.center)
            shots.append(Shot(name=name, lens=lenses[view.id_intrinsic], pose=place))
    findings = []
    if without and shots:
        message = f"{len(without)} of {len(content.views)} views of {path.name} have no pose"
        findings.append(note("unposed-views", message, *without))
    plain = content.structure if isinstance(content.structure, list) else []
    values = [entry.get("value") if isinstance(entry, dict) else None for entry in plain]
    points = sane_points([v.get("X") if isinstance(v, dict) else None for v in values])
    return frame_set(path, FORMAT, shots, points=points, findings=findings)


def _lens(path: Path, value: Any) -> Lens:
    pointer: _Pointer = checked(path, value, _Pointer, _CURE)
    camera: _Intrinsic = checked(path, pointer.ptr_wrapper.data, _Intrinsic, _CURE)
    base = camera.value0 or camera
    is_whole = None not in (base.width, base.height, base.focal_length, base.principal_point)
    if not is_whole or pointer.polymorphic_name.startswith("spherical"):
        raise refuse(
            "camera-model",
            f"{path}: the camera model {pointer.polymorphic_name or 'of a view'} is not supported",
            "Undistort the photographs with openMVG_main_ExportUndistortedImages.",
            path.name,
        )
    assert base.principal_point is not None
    terms = camera.disto_t2[:3] or camera.disto_k3 or camera.disto_k1 or camera.fisheye
    k1, k2, k3, k4 = (*terms, 0.0, 0.0, 0.0, 0.0)[:4]
    t1, t2 = (*camera.disto_t2[3:], 0.0, 0.0)[:2]
    return Lens(
        width=base.width,
        height=base.height,
        fx=base.focal_length,
        cx=base.principal_point[0] + 0.5,
        cy=base.principal_point[1] + 0.5,
        distortion=Distortion(
            radial=(k1, k2, k3, k4), tangential=(t1, t2), is_fisheye=bool(camera.fisheye)
        ),
    )
