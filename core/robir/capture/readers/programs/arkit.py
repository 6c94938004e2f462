# SPDX-License-Identifier: Apache-2.0
"""ARKit frames as 3D Scanner App writes them: frame_00000.json beside frame_00000.jpg.

"cameraPoseARFrame" is camera-to-world, row by row, with ARKit's axes, which are ours;
"intrinsics" is a matrix in pixels of the picture, row by row. Not every pose has a photograph.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import msgspec
import numpy as np
from msgspec import Meta

from robir.capture.frames import IMAGE_SUFFIXES, FrameSet, Lens
from robir.capture.readers.files import children, head, load_json
from robir.capture.readers.shots import Shot, frame_set
from robir.capture.readers.values import Number, checked

FORMAT = "arkit"

_CURE = "Export the scan from the phone again (All Data), or remove this file and its photograph."


class _Frame(msgspec.Struct, rename="camel"):
    camera_pose: Annotated[list[float], Meta(min_length=16, max_length=16)] = msgspec.field(
        name="cameraPoseARFrame"
    )
    intrinsics: Annotated[list[Number], Meta(min_length=9, max_length=9)]


def find(source: Path) -> bool:
    """Whether a folder holds such frames."""
    first = next((p for p in children(source) if p.match("frame_*.json")), None)
    return first is not None and '"cameraPoseARFrame"' in head(first)


def read(source: Path) -> FrameSet:
    """Read poses and intrinsics of the frames that have a photograph."""
    files = children(source)
    pictures = {path.stem: path for path in files if path.suffix.lower() in IMAGE_SUFFIXES}
    posed = [path for path in files if path.match("frame_*.json") and path.stem in pictures]
    shots = [_shot(path, pictures[path.stem]) for path in posed]
    images = [pictures[path.stem] for path in posed]
    return frame_set(source / "frame_*.json", FORMAT, shots, images=images)


def _shot(path: Path, photograph: Path) -> Shot:
    frame: _Frame = checked(path, load_json(path), _Frame, _CURE)
    fx, _, cx, _, fy, cy = frame.intrinsics[:6]
    pose = np.array(frame.camera_pose).reshape(4, 4)
    return Shot(name=photograph.name, lens=Lens(fx=fx, fy=fy, cx=cx, cy=cy), pose=pose)
