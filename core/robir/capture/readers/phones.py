# SPDX-License-Identifier: Apache-2.0
"""Poses as programs on phones write them: Polycam, 3D Scanner App, Record3D, Stray Scanner."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import msgspec
import numpy as np
from msgspec import Meta

from robir.capture.frames import FrameSet, Lens
from robir.capture.readers.files import (
    IMAGE_FOLDERS,
    Nine,
    Number,
    Positive,
    Side,
    Sixteen,
    checked,
    children,
    head,
    load_json,
    load_table,
    pictures_in,
)
from robir.capture.readers.shots import Shot, frame_set, opencv_pose, opengl_pose, turned_by
from robir.capture.refusal import note, refuse, some, warning

# Polycam's raw data are keyframes with one JSON file a camera: fx, fy, cx, cy, width, height and
# t_00 .. t_23, the first three rows of camera-to-world. The world is ARKit's, in metres, y up
# (README.md and core/capture_folder.py of PolyCam/polyform). `corrected_images` are undistorted and
# `corrected_cameras` globally optimised; sessions too long for that have only `images` and
# `cameras`.

_POLYCAM_CURE = "Export the raw data from Polycam again, or remove this file and its photograph."
_KEYFRAMES = "keyframes"
_PAIRS = (("corrected_cameras", "corrected_images"), ("cameras", "images"))
_SIDES = [("width", Side), ("height", Side)]
_LENS = [("fx", Positive), ("fy", Positive), ("cx", Number), ("cy", Number)]
_ROWS = [[f"t_{row}{column}" for column in range(4)] for row in range(3)]
_POSE = [(key, float) for row in _ROWS for key in row]
_Keyframe = msgspec.defstruct("_Keyframe", [*_SIDES, *_LENS, *_POSE])  # a camera file


def find_keyframes(source: Path) -> Path | None:
    """Polycam's folder of keyframes in or directly below a folder, by its camera files."""
    for place in (source, source / _KEYFRAMES):
        if _pair(place) is not None:
            return place
    # newer exports wrap everything in one more folder
    nested = [child / _KEYFRAMES for child in children(source) if _pair(child / _KEYFRAMES)]
    return nested[0] if len(nested) == 1 else None


def _pair(folder: Path) -> tuple[str, str] | None:
    """Names of the folders of cameras and photographs, the optimised ones first."""
    for cameras, images in _PAIRS:
        if (folder / images).is_dir():
            first = next((p for p in children(folder / cameras) if p.suffix == ".json"), None)
            if first is not None and '"t_00"' in head(first):
                return cameras, images
    return None


def read_keyframes(folder: Path) -> FrameSet:
    """Read Polycam's poses and intrinsics, the optimised ones if they are there."""
    pair = _pair(folder) or _PAIRS[1]
    cameras, images = (folder / name for name in pair)
    pictures = {path.stem: path for path in pictures_in(images)}
    files = [path for path in children(cameras) if path.suffix == ".json"]
    shots = []
    for path in files:
        if path.stem in pictures:
            picture = pictures[path.stem]
            camera: Any = checked(
                path, load_json(path), _Keyframe, _POLYCAM_CURE, code="bad-camera"
            )
            stated = {key: getattr(camera, key) for key, _ in (*_SIDES, *_LENS)}
            rows = np.array([[getattr(camera, key) for key in row] for row in _ROWS])
            pose = opengl_pose(rows[:, :3], rows[:, 3])
            lens, name = Lens(**stated, is_scalable=True), f"{images.name}/{picture.name}"
            shots.append(Shot(name=name, image=picture, lens=lens, pose=pose))
    alone = [path.name for path in files if path.stem not in pictures]
    message = f"{len(alone)} camera files have no photograph"
    findings = some("note", "unused-cameras", alone, message)
    if pair == _PAIRS[1]:
        message = f"{folder} has no corrected_images and corrected_cameras: poses are as the phone "
        message += "tracked them, and the photographs keep their lens distortion"
        cure = "Process the session again with loop closure on and export the raw data again."
        findings.append(warning("raw-poses", message, cure))
    return frame_set(cameras, "polycam", shots, findings)


# ARKit frames as 3D Scanner App writes them: frame_00000.json beside frame_00000.jpg.
# "cameraPoseARFrame" is camera-to-world, row by row, with ARKit's axes, which are ours;
# "intrinsics" is a matrix in pixels of the picture, row by row. Not every pose has a photograph.

_ARKIT_CURE = "Export the scan from the phone again (All Data), or remove this file and its "
_ARKIT_CURE += "photograph."


class _ArkitFrame(msgspec.Struct):
    intrinsics: Nine
    pose: Sixteen = msgspec.field(name="cameraPoseARFrame")


def is_arkit(source: Path) -> bool:
    """Whether a folder holds ARKit frames."""
    first = next((p for p in children(source) if p.match("frame_*.json")), None)
    return first is not None and '"cameraPoseARFrame"' in head(first)


def read_arkit(source: Path) -> FrameSet:
    """Read poses and intrinsics of the ARKit frames that have a photograph."""
    shots = []
    for picture in pictures_in(source):
        path = picture.with_suffix(".json")
        if path.match("frame_*.json") and path.is_file():
            frame: _ArkitFrame = checked(path, load_json(path), _ArkitFrame, _ARKIT_CURE)
            fx, _, cx, _, fy, cy = frame.intrinsics[:6]
            lens, pose = Lens(fx=fx, fy=fy, cx=cx, cy=cy), np.array(frame.pose).reshape(4, 4)
            shots.append(Shot(name=picture.name, image=picture, lens=lens, pose=pose))
    return frame_set(source / "frame_*.json", "arkit", shots)


# Record3D: metadata(.json) beside rgb or rgbd. A pose is a quaternion (x, y, z, w) and the
# position, camera-to-world with ARKit's axes, which are ours (nerfstudio, record3d_utils.py). "K"
# is stored column by column; newer recordings have fx, fy, cx and cy of every frame. Pixels count
# as ARKit's do, from the corner of the picture.

_RECORD_NAMES = ("metadata.json", "metadata")
_Seven = Annotated[list[float], Meta(min_length=7, max_length=7)]
_Four = Annotated[list[Number], Meta(min_length=4, max_length=4)]


class _Recording(msgspec.Struct):
    w: Side
    h: Side
    poses: list[_Seven]
    k: Nine = msgspec.field(name="K")
    optics: list[_Four] = msgspec.field(name="perFrameIntrinsicCoeffs", default=[])


def find_record3d(source: Path) -> Path | None:
    """Record3D's file in a folder, or in the folder that newer exports wrap it in."""
    places = [folder / name for folder in (source, source / "EXR_RGBD") for name in _RECORD_NAMES]
    return next((path for path in places if path.is_file() and is_record3d(path)), None)


def is_record3d(path: Path) -> bool:
    """Whether a file holds what only these recordings do; its keys have no order."""
    start = head(path, 1 << 22) if path.name in _RECORD_NAMES else ""
    return '"poses"' in start and '"K"' in start


def read_record3d(path: Path) -> FrameSet:
    """Read poses and intrinsics of Record3D."""
    cure = "Export the recording from Record3D again (EXR + RGBD)."
    content: _Recording = checked(path, load_json(path), _Recording, cure)
    folder = next((name for name in ("rgb", "rgbd") if (path.parent / name).is_dir()), "rgb")
    suffixes = {p.stem: p.suffix for p in children(path.parent / folder) if p.suffix != ".depth"}
    k, shots = content.k, []
    optics = content.optics
    if len(optics) != len(content.poses):
        optics = [[k[0], k[4], k[6] or k[2], k[7] or k[5]]] * len(content.poses)
    for index, (row, (fx, fy, cx, cy)) in enumerate(zip(content.poses, optics, strict=True)):
        size = {"width": content.w, "height": content.h, "is_scalable": True}
        name = f"{folder}/{index}{suffixes.get(str(index), '.jpg')}"
        pose = opengl_pose(turned_by([row[3], *row[:3]]), row[4:])
        lens = Lens(fx=fx, fy=fy, cx=cx, cy=cy, **size)
        shots.append(Shot(name=name, image=path.parent / name, lens=lens, pose=pose))
    return frame_set(path, "record3d", shots)


# Stray Scanner: odometry.csv, camera_matrix.csv and the frames of rgb.mp4. A row is a frame's
# number, position and quaternion, camera-to-world with OpenCV axes (docs/format.md of
# strayrobots/scanner); newer recordings have fx, fy, cx and cy in it. Frames that were taken out of
# the video bear their numbers.

STRAY_FILES = ("odometry.csv", "rgb.mp4")  # poses and video of a recording
FRAMES_IN_VIDEO = "frames-in-video"  # code of the finding where no frames were taken out yet
_STRAY_CURE = "Copy the recording from the phone again."


class _Odometry(msgspec.Struct):
    frame: str
    x: float
    y: float
    z: float
    qx: float
    qy: float
    qz: float
    qw: float
    fx: Number | None = None
    fy: Number | None = None
    cx: Number | None = None
    cy: Number | None = None


def read_stray_scanner(path: Path, taken: Path | None = None) -> FrameSet:
    """Poses of the frames of Stray Scanner's video, in a usual folder or in the one given."""
    root = path.parent
    places = [taken] if taken else [root / name for name in reversed(IMAGE_FOLDERS)]
    files = [file for place in places for file in pictures_in(place)]
    pictures = {file.stem.removeprefix("frame_"): file for file in files}
    heads, *lines = load_table(path, _STRAY_CURE) or [[]]
    shots = []
    for line in lines:
        plain = dict(zip(heads, line, strict=False))
        where = f"frame {plain.get('frame', '')[:80]}"
        row: _Odometry = checked(path, plain, _Odometry, _STRAY_CURE, where=where, is_text=True)
        if row.frame in pictures:
            picture, own = pictures[row.frame], [row.fx, row.fy, row.cx, row.cy]
            fx, fy, cx, cy = own if None not in own else _matrix(root / "camera_matrix.csv")
            pose = opencv_pose(turned_by([row.qw, row.qx, row.qy, row.qz]), [row.x, row.y, row.z])
            name = picture.relative_to(taken or root).as_posix()
            lens = Lens(fx=fx, fy=fy, cx=cx, cy=cy)
            shots.append(Shot(name=name, image=picture, lens=lens, pose=pose))
    if not shots:
        raise refuse(
            FRAMES_IN_VIDEO,
            f"{path} is a recording of Stray Scanner whose frames are still in its video",
            'Take them out, in its folder: mkdir rgb, then "ffmpeg -i rgb.mp4 -start_number 0 '
            '-q:v 2 rgb/%06d.jpg"; keep about 200 that are sharp.',
            path.name,
        )
    findings = []
    if len(shots) < len(lines):
        message = f"{len(lines) - len(shots)} poses of {path.name} have no photograph"
        findings.append(note("unused-cameras", message))
    found = frame_set(path, "stray-scanner", shots, findings)
    return found if taken is None else replace(found, root=taken)


def _matrix(path: Path) -> list[float]:
    """Focal lengths and principal point of the camera matrix."""
    rows = load_table(path, _STRAY_CURE)
    table = checked(path, rows, list[list[Number]], _STRAY_CURE, is_text=True)
    if len(table) < 2 or any(len(row) < 3 for row in table[:2]):
        raise refuse("bad-table", f"{path} is no matrix of 3x3 numbers", _STRAY_CURE, path.name)
    return [table[0][0], table[1][1], table[0][2], table[1][2]]
