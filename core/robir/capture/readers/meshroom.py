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

from pathlib import Path
from typing import Annotated, Any

import msgspec
import numpy as np
from msgspec import Meta

from robir.capture.frames import Array, Distortion, FrameSet, Lens, checked_lens
from robir.capture.readers.files import head, load_json
from robir.capture.readers.shots import Shot, Vector, frame_set, opencv_pose, sane_points
from robir.capture.readers.values import Identity, Number, Positive, Side, checked
from robir.capture.refusal import CaptureRefusedError, note, refuse

FORMAT = "meshroom"

_CURE = "Take cameras.sfm from the folder of Meshroom's StructureFromMotion node."
_NONE = ("", "none")

Version = Annotated[list[Annotated[int, Meta(ge=0, le=1000)]], Meta(max_length=3)]


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
    principal_point: Annotated[list[Number], Meta(min_length=2, max_length=2)]
    px_focal_length: Positive | Annotated[list[Positive], Meta(min_length=2, max_length=2)] = 0.0
    focal_length: Positive | None = None
    sensor_width: Positive = 36.0
    pixel_ratio: Positive = 1.0
    distortion_type: str | None = None
    undistortion_type: str = "none"
    distortion_params: Annotated[list[Number], Meta(max_length=64)] | None = None


class _SubPose(msgspec.Struct):
    pose: _Transform


class _Rig(msgspec.Struct, rename="camel"):
    rig_id: Identity
    sub_poses: list[_SubPose] = []


class _File(msgspec.Struct):
    views: list[_View]
    version: Version = msgspec.field(default_factory=lambda: [1, 0, 0])
    poses: list[_Posed] = []
    intrinsics: list[_Intrinsic] = []
    rigs: list[_Rig] = []
    structure: Any = ()


def looks_like(path: Path) -> bool:
    """Whether a file is JSON with Meshroom's views."""
    if path.suffix.lower() not in (".sfm", ".json"):
        return False
    start = head(path)
    return '"views"' in start and '"viewId"' in start


def read(path: Path) -> FrameSet:
    """Read views that have a pose, and the sparse points.

    Frames in the frame of the file.
    """
    plain = load_json(path)
    content: _File = checked(path, plain, _File, _CURE, code="bad-sfm", is_text=True)
    version = tuple(content.version)
    poses = {entry.pose_id: entry.pose.transform for entry in content.poses}
    lenses = {entry.intrinsic_id: entry for entry in content.intrinsics}
    views = [view for view in content.views if view.pose_id in poses]
    if not views:
        raise refuse("no-poses", f"{path} holds no view with a pose", _CURE, path.name)
    lost = next((view for view in views if view.intrinsic_id not in lenses), None)
    if lost is not None:
        raise _bad(path, f"the intrinsics {lost.intrinsic_id!r} of {lost.path} are missing")
    shots = [
        Shot(
            name=view.path,
            lens=_lens(path, version, lenses[view.intrinsic_id]),
            pose=_pose(path, content, view, poses[view.pose_id]),
        )
        for view in views
    ]
    without = [view.path for view in content.views if view.pose_id not in poses]
    findings = []
    if without:
        message = f"{len(without)} of {len(content.views)} views of {path.name} have no pose"
        findings.append(note("unposed-views", message, *(Path(p).name for p in without)))
    return frame_set(path, FORMAT, shots, points=_points(content), findings=findings)


def _bad(path: Path, fault: str) -> CaptureRefusedError:
    return refuse(
        "bad-sfm", f"{path} is no complete structure from motion ({fault})", _CURE, path.name
    )


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


def _points(content: _File) -> Array:
    """Sparse points, (N, 3); none if they are damaged, for they only help."""
    plain = content.structure if isinstance(content.structure, list) else []
    return sane_points([point.get("X") if isinstance(point, dict) else None for point in plain])


def _lens(path: Path, version: tuple[int, ...], entry: _Intrinsic) -> Lens:
    focals = _focals(version, entry)
    kind, values = _distortion_of(entry)
    if focals is None:
        raise _bad(path, f"intrinsics {entry.intrinsic_id!r} have no focal length")
    cx, cy = entry.principal_point
    if version >= (1, 2, 1):
        cx, cy = cx + 0.5 * entry.width, cy + 0.5 * entry.height
    try:
        distortion = _distortion(kind, values)
    except ValueError as fault:
        raise _bad(path, str(fault)) from None
    if distortion is None:
        message = f"{path}: the camera model {kind} is not supported"
        cure = "Export undistorted photographs (Meshroom's PrepareDenseScene or ExportImages)."
        raise refuse("camera-model", message, cure, path.name)
    lens = Lens(
        width=entry.width,
        height=entry.height,
        fx=focals[0],
        fy=focals[1],
        cx=cx + 0.5,
        cy=cy + 0.5,
        distortion=distortion,
    )
    return checked_lens(lens, path, f"intrinsic {entry.intrinsic_id}")


def _focals(version: tuple[int, ...], entry: _Intrinsic) -> tuple[float, float] | None:
    """Focal lengths in pixels, or None where there are none."""
    pixels = entry.px_focal_length
    if version < (1, 2, 0):
        return (pixels, pixels) if isinstance(pixels, float) and pixels > 0 else None
    if version < (1, 2, 2):
        return (pixels[0], pixels[1]) if isinstance(pixels, list) else None
    if entry.focal_length is None:
        return None
    fx = entry.focal_length / entry.sensor_width * entry.width
    return fx, (fx / entry.pixel_ratio if version < (1, 2, 5) else fx * entry.pixel_ratio)


def _distortion_of(entry: _Intrinsic) -> tuple[str, list[float]]:
    """Name of the distortion and its numbers; newer files keep it apart from the projection."""
    projection = entry.type.lower()
    kind = (projection if entry.distortion_type is None else entry.distortion_type).lower()
    undistortion = entry.undistortion_type.lower()
    if undistortion not in _NONE:
        return undistortion, []
    if projection.startswith(("equidistant", "equirectangular", "fisheye")):
        kind = projection
    return kind, list(entry.distortion_params or ())


def _distortion(kind: str, values: list[float]) -> Distortion | None:
    """The distortion in our terms, or None if there is no such thing."""
    radial = (*values, 0.0, 0.0, 0.0, 0.0)
    match kind.replace("radialk", "radial"):
        case "none" | "" | "pinhole":
            return Distortion()
        case "radial1":
            return Distortion(radial=(radial[0], 0.0, 0.0, 0.0))
        case "radial3":
            return Distortion(radial=(radial[0], radial[1], radial[2], 0.0))
        case "brown":
            k1, k2, k3, t1, t2 = values
            return Distortion(radial=(k1, k2, k3, 0.0), tangential=(t1, t2))
        case "fisheye4" | "fisheye":
            k1, k2, k3, k4 = values
            return Distortion(radial=(k1, k2, k3, k4), is_fisheye=True)
        case _:
            return None
