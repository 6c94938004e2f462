# SPDX-License-Identifier: Apache-2.0
"""3D Gaussian splatting: cameras.json of a training run.

"rotation" is camera-to-world with OpenCV axes, row by row, "position" the centre; the principal
point is the middle (graphdeco-inria/gaussian-splatting, utils/camera_utils.py: `camera_to_JSON`).
Photographs lie elsewhere, often larger than the run used them.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import msgspec
from msgspec import Meta

from robir.capture.frames import FrameSet, Lens
from robir.capture.readers.files import head, load_json
from robir.capture.readers.shots import Shot, Vector, frame_set, opencv_pose
from robir.capture.readers.values import Positive, Side, checked

FORMAT = "gaussian-splatting"

_CURE = "Take cameras.json from the output folder of the training."


class _Camera(msgspec.Struct):
    img_name: Annotated[str, Meta(min_length=1)]
    width: Side
    height: Side
    fx: Positive
    fy: Positive
    position: Vector
    rotation: Annotated[list[Vector], Meta(min_length=3, max_length=3)]


def looks_like(path: Path) -> bool:
    """Whether a JSON file is a list of such cameras."""
    start = head(path)
    return start.lstrip().startswith("[") and '"img_name"' in start and '"rotation"' in start


def read(path: Path) -> FrameSet:
    """Read poses and focal lengths."""
    cameras: list[_Camera] = checked(path, load_json(path), list[_Camera], _CURE)
    shots = []
    for c in cameras:
        lens = Lens(width=c.width, height=c.height, fx=c.fx, fy=c.fy, is_scalable=True)
        shots.append(Shot(name=c.img_name, lens=lens, pose=opencv_pose(c.rotation, c.position)))
    return frame_set(path, FORMAT, shots)
