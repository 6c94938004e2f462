# SPDX-License-Identifier: Apache-2.0
"""Stray Scanner on a phone: odometry.csv, camera_matrix.csv and the frames of rgb.mp4.

A row is a frame's number, position and quaternion, camera-to-world with OpenCV axes
(docs/format.md of strayrobots/scanner); newer recordings have fx, fy, cx and cy in it. The frames
must have been taken out of the video, under their numbers.
"""

from __future__ import annotations

from pathlib import Path

import msgspec

from robir.capture.frames import IMAGE_SUFFIXES, FrameSet, Lens
from robir.capture.readers.files import IMAGE_FOLDERS, children, head, load_table
from robir.capture.readers.shots import Shot, frame_set, opencv_pose, turned_by
from robir.capture.readers.values import Number, checked
from robir.capture.refusal import note, refuse

FORMAT = "stray-scanner"
NAME = "odometry.csv"

_CURE = "Copy the recording from the phone again."
_MATRIX = "camera_matrix.csv"


class _Row(msgspec.Struct):
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


def looks_like(path: Path) -> bool:
    """Whether a table has frames and quaternions."""
    columns = {word.strip() for word in head(path, 4096).partition("\n")[0].split(",")}
    return {"frame", "qx", "qy", "qz", "qw"} <= columns


def read(path: Path) -> FrameSet:
    """Read the poses of the frames that were taken out of the video."""
    root = path.parent
    places = [root / name for name in IMAGE_FOLDERS]
    pictures = {
        file.stem: file
        for place in reversed(places)
        for file in children(place)
        if file.suffix.lower() in IMAGE_SUFFIXES
    }
    lines = load_table(path, _CURE)
    heads = lines[0] if lines else []
    shots, images = [], []
    for line in lines[1:]:
        plain = dict(zip(heads, line, strict=False))
        where = f"frame {plain.get('frame', '')[:80]}"
        row: _Row = checked(path, plain, _Row, _CURE, where=where, is_text=True)
        if row.frame in pictures:
            own = [row.fx, row.fy, row.cx, row.cy]
            fx, fy, cx, cy = own if None not in own else _matrix(root / _MATRIX)
            pose = opencv_pose(turned_by([row.qw, row.qx, row.qy, row.qz]), [row.x, row.y, row.z])
            lens = Lens(fx=fx, fy=fy, cx=cx, cy=cy)
            images.append(pictures[row.frame])
            shots.append(Shot(name=images[-1].relative_to(root).as_posix(), lens=lens, pose=pose))
    if not shots:
        raise refuse(
            "frames-in-video",
            f"{path} is a recording of Stray Scanner whose frames are still in its video",
            'Take them out, in its folder: mkdir rgb, then "ffmpeg -i rgb.mp4 -start_number 0 '
            '-q:v 2 rgb/%06d.jpg"; keep about 200 that are sharp.',
            path.name,
        )
    findings = []
    if len(shots) < len(lines) - 1:
        message = f"{len(lines) - 1 - len(shots)} poses of {path.name} have no photograph"
        findings.append(note("unused-cameras", message))
    return frame_set(path, FORMAT, shots, images=images, findings=findings)


def _matrix(path: Path) -> list[float]:
    """Focal lengths and principal point of the camera matrix."""
    table = checked(path, load_table(path, _CURE), list[list[Number]], _CURE, is_text=True)
    if len(table) < 2 or any(len(row) < 3 for row in table[:2]):
        raise refuse("bad-table", f"{path} is no matrix of 3x3 numbers", _CURE, path.name)
    return [table[0][0], table[1][1], table[0][2], table[1][2]]
