# SPDX-License-Identifier: Apache-2.0
"""sdfstudio: meta_data.json.

"camtoworld" has OpenCV axes, "intrinsics" is a matrix in pixels (nerfstudio,
sdfstudio_dataparser.py). Poses stay in the file's own frame, which "worldtogt" would carry into
that of the data set they were made from.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import msgspec
import numpy as np
from msgspec import Meta

from robir.capture.frames import Distortion, FrameSet, Lens
from robir.capture.readers.files import head, load_json
from robir.capture.readers.shots import Shot, frame_set, opencv_pose
from robir.capture.readers.values import Matrix, Number, Side, checked
from robir.capture.refusal import refuse

FORMAT = "sdfstudio"
NAME = "meta_data.json"

_CURE = "Write it as sdfstudio's process_data scripts do."
_Row = Annotated[list[Number], Meta(min_length=3, max_length=4)]
_Rows = Annotated[list[_Row], Meta(min_length=3, max_length=4)]


class _Frame(msgspec.Struct):
    rgb_path: str
    camtoworld: Matrix
    intrinsics: _Rows
    foreground_mask: str | None = None


class _File(msgspec.Struct):
    width: Side
    height: Side
    frames: list[_Frame]
    camera_model: str = "OPENCV"


def looks_like(path: Path) -> bool:
    """Whether a JSON file holds such poses."""
    start = head(path)
    return '"camtoworld"' in start and '"rgb_path"' in start


def read(path: Path) -> FrameSet:
    """Read poses, intrinsics and masks."""
    content: _File = checked(path, load_json(path), _File, _CURE)
    shots = [_shot(path, content, frame) for frame in content.frames]
    images = [path.parent / shot.name for shot in shots]
    return frame_set(path, FORMAT, shots, images=images)


def _shot(path: Path, content: _File, frame: _Frame) -> Shot:
    rows = frame.camtoworld[:3]
    if len(rows) != 3 or any(len(row) != 4 for row in rows):
        message = f'{path}: "camtoworld" of {frame.rgb_path[:80]} is no 4x4 matrix of numbers'
        raise refuse("bad-pose", message, "Write four rows of four numbers.", path.name)
    pose = np.array(rows)
    (fx, skew, cx), (_, fy, cy) = frame.intrinsics[0][:3], frame.intrinsics[1][:3]
    lens = Lens(
        width=content.width,
        height=content.height,
        fx=fx,
        fy=fy,
        cx=cx,
        cy=cy,
        distortion=Distortion(skew=skew / fx if fx else 0.0),
    )
    mask = frame.foreground_mask
    return Shot(
        name=frame.rgb_path, lens=lens, pose=opencv_pose(pose[:, :3], pose[:, 3]), mask=mask
    )
