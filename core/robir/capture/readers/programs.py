# SPDX-License-Identifier: Apache-2.0
"""Poses as other programs write them: OpenSfM, OpenMVG, Bundler."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import msgspec
import numpy as np
from msgspec import Meta
from scipy.spatial.transform import Rotation

from robir.capture.frames import Array, Distortion, FrameSet, Lens
from robir.capture.readers.files import (
    Number,
    Point,
    Positive,
    Side,
    Terms,
    Turn,
    Vector,
    checked,
    load_json,
    parsed,
    sane_points,
)
from robir.capture.readers.shots import Shot, frame_set, opencv_pose, opencv_view, opengl_pose
from robir.capture.refusal import note, refuse, some

# OpenSfM and OpenDroneMap: reconstruction.json. A shot holds the rotation (axis times angle) and
# translation from world to camera with OpenCV axes. Image points are counted from the middle of the
# picture in lengths of its longer side, which scales focal lengths too (doc/source/geometry.rst;
# `normalized_image_coordinates` of opensfm/features.py puts pixel centres at half integers). A shot
# of a rig has the pose of its own camera.

_SFM_CURE = "Take reconstruction.json from the folder opensfm of the project."
# radial terms of each projection that is read (`camera_from_json` of opensfm/io.py)
_RADIAL = {"perspective": 2, "simple_radial": 1, "radial": 2, "brown": 3, "fisheye": 2}
_RADIAL |= {"fisheye_opencv": 4}


class _SfmCamera(msgspec.Struct):
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


class _SfmShot(msgspec.Struct):
    rotation: Vector
    camera: str
    translation: Vector = msgspec.field(default_factory=lambda: [0.0, 0.0, 0.0])


class _Reconstruction(msgspec.Struct):
    cameras: dict[str, _SfmCamera]
    shots: dict[str, _SfmShot]
    points: Any = None


def read_opensfm(path: Path) -> FrameSet:
    """Read the largest reconstruction of OpenSfM."""
    parts: list[_Reconstruction] = checked(path, load_json(path), list[_Reconstruction], _SFM_CURE)
    largest = max(parts, key=lambda part: len(part.shots), default=_Reconstruction({}, {}))
    findings = []
    if len(parts) > 1:
        counts = ", ".join(str(len(part.shots)) for part in parts)
        message = f"{path.name} holds reconstructions of {counts} photographs; the largest is used"
        findings.append(note("several-models", message))
    shots = []
    for name, shot in largest.shots.items():
        if shot.camera not in largest.cameras:
            message = f"{path}: the camera of {name} is missing"
            raise refuse("bad-value", message, _SFM_CURE, path.name)
        with np.errstate(all="ignore"):
            turn = Rotation.from_rotvec(shot.rotation).as_matrix()
        lens = _sfm_lens(path, largest.cameras[shot.camera])
        shots.append(Shot(name=name, lens=lens, pose=opencv_view(turn, shot.translation)))
    points = largest.points.values() if isinstance(largest.points, dict) else ()
    cloud = sane_points([_at(point, "coordinates") for point in points])
    return frame_set(path, "opensfm", shots, findings, cloud)


def _sfm_lens(path: Path, camera: _SfmCamera) -> Lens:
    fx = camera.focal if camera.focal_x is None else camera.focal_x
    kind = camera.projection_type
    if kind not in _RADIAL:
        message = f"{path}: the camera model {kind} is not supported"
        cure = "Undistort the photographs with `opensfm undistort` and take the reconstruction "
        raise refuse("camera-model", message, cure + "there.", path.name)
    if fx is None:
        message = f"{path}: a camera has no focal length"
        raise refuse("bad-intrinsics", message, _SFM_CURE, path.name)
    fy = fx if camera.focal_y is None else camera.focal_y
    longer = max(camera.width, camera.height)
    terms = (camera.k1, camera.k2, camera.k3, camera.k4)
    k1, k2, k3, k4 = (*terms[: _RADIAL[kind]], 0.0, 0.0, 0.0)[:4]
    cx, cy = 0.5 * camera.width + camera.c_x * longer, 0.5 * camera.height + camera.c_y * longer
    bent = Distortion(radial=(k1, k2, k3, k4), is_fisheye=kind.startswith("fisheye"))
    bent = replace(bent, tangential=(camera.p1, camera.p2)) if kind == "brown" else bent
    lens = Lens(width=camera.width, height=camera.height, distortion=bent)
    return replace(lens, fx=fx * longer, fy=fy * longer, cx=cx, cy=cy)


# OpenMVG: sfm_data.json, as cereal writes it. Poses hold the rotation from world to camera with
# OpenCV axes, row by row, and the centre. Pixel centres lie at integers (undistortion samples at
# whole pixels), so half a pixel is added to the principal point, as for AliceVision, which grew
# from it. Distortion is that of src/openMVG/cameras: k1 to k3, and T1 and T2 of Brown's model are
# OpenCV's p1 and p2.

_MVG_CURE = "Write it again: openMVG_main_ConvertSfM_DataFormat -i sfm_data.bin -o sfm_data.json."


class _MvgView(msgspec.Struct):
    filename: str
    id_intrinsic: int
    id_pose: int
    local_path: str = ""


class _MvgCamera(msgspec.Struct):
    width: Side
    height: Side
    focal_length: Positive
    principal_point: Point
    disto_k1: Terms = []
    disto_k3: Terms = []
    disto_t2: Terms = []
    fisheye: Terms = []


class _MvgPose(msgspec.Struct):
    rotation: Turn
    center: Vector


class _MvgScene(msgspec.Struct):
    views: list[dict[str, Any]]
    intrinsics: list[dict[str, Any]]
    extrinsics: list[dict[str, Any]]
    structure: Any = None


def read_openmvg(path: Path) -> FrameSet:
    """Read views of OpenMVG that have a pose, and the sparse points."""
    content: _MvgScene = checked(path, load_json(path), _MvgScene, _MVG_CURE)
    poses: dict[str, _MvgPose] = {
        key: checked(path, value, _MvgPose, _MVG_CURE) for key, value in _pairs(content.extrinsics)
    }
    lenses = {key: _mvg_lens(path, value) for key, value in _pairs(content.intrinsics)}
    shots, without = [], []
    for _, value in _pairs(content.views):
        view: _MvgView = checked(path, _pointed(value), _MvgView, _MVG_CURE)
        name = f"{view.local_path}/{view.filename}".lstrip("/")
        pose = poses.get(str(view.id_pose))
        if pose is None:
            without.append(name)
        elif str(view.id_intrinsic) not in lenses:
            raise refuse("bad-value", f"{path}: {name} has no intrinsics", _MVG_CURE, path.name)
        else:
            place = opencv_pose(np.array(pose.rotation).T, pose.center)
            shots.append(Shot(name=name, lens=lenses[str(view.id_intrinsic)], pose=place))
    message = f"{len(without)} of {len(content.views)} views of {path.name} have no pose"
    findings = some("note", "unposed-views", without, message)
    points = sane_points([_at(value, "X") for _, value in _pairs(content.structure)])
    return frame_set(path, "openmvg", shots, findings, points)


def _mvg_lens(path: Path, value: Any) -> Lens:
    kind, plain = str(_at(value, "polymorphic_name")), _pointed(value)
    if kind.startswith("spherical"):
        message = f"{path}: the camera model {kind} is not supported"
        cure = "Undistort the photographs with openMVG_main_ExportUndistortedImages."
        raise refuse("camera-model", message, cure, path.name)
    base = _at(plain, "value0")  # some lenses hold their pinhole in it
    plain = {**base, **plain} if isinstance(base, dict) else plain
    camera: _MvgCamera = checked(path, plain, _MvgCamera, _MVG_CURE)
    terms = camera.disto_t2[:3] or camera.disto_k3 or camera.disto_k1 or camera.fisheye
    k1, k2, k3, k4 = (*terms, 0.0, 0.0, 0.0, 0.0)[:4]
    t1, t2 = (*camera.disto_t2[3:], 0.0, 0.0)[:2]
    bent = Distortion(radial=(k1, k2, k3, k4), tangential=(t1, t2), is_fisheye=bool(camera.fisheye))
    cx, cy = (value + 0.5 for value in camera.principal_point)
    lens = Lens(width=camera.width, height=camera.height, fx=camera.focal_length)
    return replace(lens, cx=cx, cy=cy, distortion=bent)


def _pairs(entries: Any) -> list[tuple[str, Any]]:
    """Keys and values of one of cereal's maps."""
    entries = entries if isinstance(entries, list) else []
    return [(str(_at(entry, "key")), _at(entry, "value")) for entry in entries]


def _pointed(value: Any) -> Any:
    """What one of cereal's pointers points to."""
    return _at(_at(value, "ptr_wrapper"), "data")


def _at(table: Any, key: str) -> Any:
    return table.get(key) if isinstance(table, dict) else None


# Bundler: bundle.out. A camera is its focal length in pixels, k1, k2, the rotation row by row and
# the translation from world to camera. Cameras look along their -z with y up, which is our own
# convention; image points count from the middle of the picture (Bundler user's manual, "Output
# format"). A focal length of 0 is a photograph that was not placed. Photographs stand in list.txt,
# line by line in this order.

_BUNDLE_CURE = "Export it as Bundler again, with its list of photographs."
_Counts = Annotated[list[Annotated[int, Meta(ge=0, le=10**7)]], Meta(min_length=2, max_length=2)]
_BundleRow = Annotated[list[float], Meta(min_length=15, max_length=15)]


def read_bundler(path: Path) -> FrameSet:
    """Read placed cameras of Bundler and sparse points."""
    names = _bundled(path)
    lines = [line for line in _lines(path) if line.strip()[:1] not in ("#", "")]
    first = lines[0].split() if lines else []
    cameras, points = checked(path, first, _Counts, _BUNDLE_CURE, where="the counts", is_text=True)
    if cameras > len(names) or len(lines) < 1 + 5 * cameras:
        message = f"{path} states {cameras} cameras, but holds {len(lines) - 1} lines and "
        message += f"{len(names)} photographs are listed"
        raise refuse("bad-bundle", message, _BUNDLE_CURE, path.name)
    shots, lost = [], []
    for index, name in enumerate(names[:cameras]):
        words = " ".join(lines[1 + 5 * index : 6 + 5 * index]).split()
        row: Array = np.array(
            checked(path, words, _BundleRow, _BUNDLE_CURE, where=name[:80], is_text=True)
        )
        focal, k1, k2 = row[:3].tolist()
        if focal == 0:
            lost.append(name)
            continue
        turn = row[3:12].reshape(3, 3).T
        with np.errstate(all="ignore"):
            pose = opengl_pose(turn, -turn @ row[12:])
        lens = Lens(fx=focal, distortion=Distortion(radial=(k1, k2, 0.0, 0.0)))
        shots.append(Shot(name=name, lens=lens, pose=pose))
    message = f"{len(lost)} of {cameras} photographs of {path.name} were not placed"
    cloud = sane_points([row.split()[:3] for row in lines[1 + 5 * cameras :: 3][:points]])
    return frame_set(path, "bundler", shots, some("note", "unposed-views", lost, message), cloud)


def _bundled(path: Path) -> list[str]:
    """The listed photographs; other programs name the list after the file of cameras."""
    own = path.with_name(path.name.replace("bundle.out", "list.txt"))
    places = [own, path.with_name("list.txt"), path.parent.parent / "list.txt"]
    listed = next((place for place in places if place != path and place.is_file()), None)
    if listed is None:
        message = f"{path} names no photographs, and there is no list.txt beside it"
        cure = "Put the list of photographs that it was made from beside it, as list.txt."
        raise refuse("missing-list", message, cure, path.name)
    # a name may be followed by 0 and the focal length from EXIF
    words = [(line.strip(), line.rsplit(maxsplit=2)) for line in _lines(listed) if line.strip()]
    return [w[0] if len(w) == 3 and w[1] == "0" else line for line, w in words]


def _lines(path: Path) -> list[str]:
    return parsed(path, str.splitlines, "text", _BUNDLE_CURE, "bad-bundle")
