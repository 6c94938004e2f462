# SPDX-License-Identifier: Apache-2.0
"""Meshroom (AliceVision): cameras.sfm, the JSON of a structure from motion.

Poses hold the centre and, column by column, the rotation from world to camera with OpenCV axes, so
that the nine numbers read row by row are camera-to-world (saveMatrix in AliceVision's jsonIO.hpp).
Pixel centres lie at integers (cameraUndistortImage.hpp), so half a pixel is added to the principal
point. How intrinsics are written has changed (loadIntrinsic in jsonIO.cpp): before 1.2 in pixels
with one focal length, in 1.2.0 with two; before 1.2.1 the principal point counts from the corner,
later it is the offset from the middle; from 1.2.2 the focal length is in millimetres of
"sensorWidth", and "pixelRatio" is fx / fy before 1.2.5 and fy / fx from then on.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import msgspec
import numpy as np
from msgspec import Meta

from robir.capture.frames import Array, Distortion, FrameSet, Lens, checked_lens
from robir.capture.readers.files import (
    Identity,
    Point,
    Positive,
    Side,
    Terms,
    Vector,
    checked,
    load_json,
    sane_points,
)
from robir.capture.readers.shots import Shot, frame_set, opencv_pose
from robir.capture.refusal import CaptureRefusedError, refuse, some

_CURE = "Take cameras.sfm from the folder of Meshroom's StructureFromMotion node."
_Focals = Annotated[list[Positive], Meta(min_length=2, max_length=2)]
_Version = Annotated[list[Annotated[int, Meta(ge=0, le=1000)]], Meta(max_length=3)]


class _Transform(msgspec.Struct):
    rotation: Annotated[list[float], Meta(min_length=9, max_length=9)]
    center: Vector


class _Pose(msgspec.Struct):
    transform: _Transform


class _Posed(msgspec.Struct, rename="camel"):
    pose_id: Identity
    pose: _Pose


class _View(msgspec.Struct, rename="camel"):
    path: str = ""
    pose_id: Identity = ""
    intrinsic_id: Identity = ""
    is_pose_independant: bool = True
    rig_id: str = ""
    sub_pose_id: int = -1


class _Intrinsic(msgspec.Struct, rename="camel"):
    intrinsic_id: Identity
    width: Side
    height: Side
    type: str
    principal_point: Point
    px_focal_length: Positive | _Focals = 0.0
    focal_length: Positive | None = None
    sensor_width: Positive = 36.0
    pixel_ratio: Positive = 1.0
    distortion_type: str | None = None
    undistortion_type: str = "none"
    distortion_params: Terms | None = None


class _SubPose(msgspec.Struct):
    pose: _Transform


class _Rig(msgspec.Struct, rename="camel"):
    rig_id: Identity
    sub_poses: list[_SubPose] = []


class _File(msgspec.Struct):
    views: list[_View]
    version: _Version = msgspec.field(default_factory=lambda: [1, 0, 0])
    poses: list[_Posed] = []
    intrinsics: list[_Intrinsic] = []
    rigs: list[_Rig] = []
    structure: Any = ()


def read(path: Path) -> FrameSet:
    """Read views that have a pose, and the sparse points, in the frame of the file."""
    plain = load_json(path)
    content: _File = checked(path, plain, _File, _CURE, code="bad-sfm", is_text=True)
    version = tuple(content.version)
    poses = {entry.pose_id: entry.pose.transform for entry in content.poses}
    lenses = {entry.intrinsic_id: entry for entry in content.intrinsics}
    views = [view for view in content.views if view.pose_id in poses]
    if not views:
        raise refuse("no-poses", f"{path} holds no view with a pose", _CURE, path.name)
    shots = []
    for view in views:
        if view.intrinsic_id not in lenses:
            raise _bad(path, f"the intrinsics {view.intrinsic_id!r} of {view.path} are missing")
        lens = _lens(path, version, lenses[view.intrinsic_id])
        pose = _pose(path, content, view, poses[view.pose_id])
        shots.append(Shot(name=view.path, lens=lens, pose=pose))
    without = [Path(view.path).name for view in content.views if view.pose_id not in poses]
    message = f"{len(without)} of {len(content.views)} views of {path.name} have no pose"
    found = some("note", "unposed-views", without, message)
    points = content.structure if isinstance(content.structure, list) else []
    cloud = [point.get("X") if isinstance(point, dict) else None for point in points]
    return frame_set(path, "meshroom", shots, found, sane_points(cloud))


def _bad(path: Path, fault: str) -> CaptureRefusedError:
    message = f"{path} is no complete structure from motion ({fault})"
    return refuse("bad-sfm", message, _CURE, path.name)


def _pose(path: Path, content: _File, view: _View, transform: _Transform) -> Array:
    """Our pose; in a rig, the stored pose is the rig's and its camera has one within it."""
    turn, centre = np.array(transform.rotation).reshape(3, 3), np.array(transform.center)
    if view.is_pose_independant:
        return opencv_pose(turn, centre)
    rig = next((rig.sub_poses for rig in content.rigs if rig.rig_id == view.rig_id), [])
    if not 0 <= view.sub_pose_id < len(rig):
        message = f"{path}: {view.path} belongs to a rig of cameras that is not in the file"
        raise refuse("rig", message, "Reconstruct the photographs without rigs.", path.name)
    place = rig[view.sub_pose_id].pose
    with np.errstate(all="ignore"):
        inner = turn @ np.array(place.rotation).reshape(3, 3)
        return opencv_pose(inner, centre + turn @ np.array(place.center))


def _lens(path: Path, version: tuple[int, ...], entry: _Intrinsic) -> Lens:
    focals = _focals(version, entry)
    if focals is None:
        raise _bad(path, f"intrinsics {entry.intrinsic_id!r} have no focal length")
    cx, cy = entry.principal_point
    if version >= (1, 2, 1):
        cx, cy = cx + 0.5 * entry.width, cy + 0.5 * entry.height
    lens = Lens(width=entry.width, height=entry.height, distortion=_distortion(path, entry))
    lens = replace(lens, fx=focals[0], fy=focals[1], cx=cx + 0.5, cy=cy + 0.5)
    return checked_lens(lens, path, f"intrinsic {entry.intrinsic_id}")


def _focals(version: tuple[int, ...], entry: _Intrinsic) -> tuple[float, float] | None:
    pixels = entry.px_focal_length
    if version < (1, 2, 0):
        return (pixels, pixels) if isinstance(pixels, float) and pixels > 0 else None
    if version < (1, 2, 2):
        return (pixels[0], pixels[1]) if isinstance(pixels, list) else None
    if entry.focal_length is None:
        return None
    fx = entry.focal_length / entry.sensor_width * entry.width
    return fx, (fx / entry.pixel_ratio if version < (1, 2, 5) else fx * entry.pixel_ratio)


def _distortion(path: Path, entry: _Intrinsic) -> Distortion:
    """The distortion in our terms; newer files keep it apart from the projection."""
    projection, undistortion = entry.type.lower(), entry.undistortion_type.lower()
    kind = (projection if entry.distortion_type is None else entry.distortion_type).lower()
    if projection.startswith(("equidistant", "equirectangular", "fisheye")):
        kind = projection
    kind = kind if undistortion in ("", "none") else undistortion
    k1, k2, k3, k4, k5 = (*(entry.distortion_params or ()), *[0.0] * 5)[:5]
    match kind.replace("radialk", "radial"):
        case "none" | "" | "pinhole":
            return Distortion()
        case "radial1":
            return Distortion(radial=(k1, 0.0, 0.0, 0.0))
        case "radial3":
            return Distortion(radial=(k1, k2, k3, 0.0))
        case "brown":
            return Distortion(radial=(k1, k2, k3, 0.0), tangential=(k4, k5))
        case "fisheye4" | "fisheye":
            return Distortion(radial=(k1, k2, k3, k4), is_fisheye=True)
    message = f"{path}: the camera model {kind} is not supported"
    cure = "Export undistorted photographs (Meshroom's PrepareDenseScene or ExportImages)."
    raise refuse("camera-model", message, cure, path.name)
