# SPDX-License-Identifier: Apache-2.0
"""Record3D on a phone: metadata(.json) beside rgb or rgbd.

A pose is a quaternion (x, y, z, w) and the position, camera-to-world with ARKit's axes, which are
ours (nerfstudio, record3d_utils.py). "K" is stored column by column; newer recordings have fx, fy,
cx and cy of every frame. Pixels count as ARKit's do, from the corner of the picture.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import msgspec
import numpy as np
from msgspec import Meta

from robir.capture.frames import FrameSet, Lens
from robir.capture.readers.files import children, head, load_json
from robir.capture.readers.shots import Shot, frame_set, turned_by
from robir.capture.readers.values import Number, Side, checked

FORMAT = "record3d"

_CURE = "Export the recording from Record3D again (EXR + RGBD)."
_NAMES = ("metadata.json", "metadata")
_Pose = Annotated[list[float], Meta(min_length=7, max_length=7)]
_Optics = Annotated[list[Number], Meta(min_length=4, max_length=4)]


class _File(msgspec.Struct):
    w: Side
    h: Side
    poses: list[_Pose]
    k: Annotated[list[Number], Meta(min_length=9, max_length=9)] = msgspec.field(name="K")
    optics: list[_Optics] = msgspec.field(name="perFrameIntrinsicCoeffs", default=[])


def find(source: Path) -> Path | None:
    """The file of poses in a folder, or in the folder that newer exports wrap it in."""
    places = [folder / name for folder in (source, source / "EXR_RGBD") for name in _NAMES]
    return next((path for path in places if path.is_file() and looks_like(path)), None)


def looks_like(path: Path) -> bool:
    """Whether a file holds what only these recordings do; its keys have no order."""
    start = head(path, 1 << 22)
    return path.name in _NAMES and '"poses"' in start and '"K"' in start


def read(path: Path) -> FrameSet:
    """Read poses and intrinsics."""
    content: _File = checked(path, load_json(path), _File, _CURE)
    folder = next((name for name in ("rgb", "rgbd") if (path.parent / name).is_dir()), "rgb")
    suffixes = {p.stem: p.suffix for p in children(path.parent / folder) if p.suffix != ".depth"}
    k = content.k
    shots = []
    for index, row in enumerate(content.poses):
        has_own = len(content.optics) == len(content.poses)
        own = content.optics[index] if has_own else [k[0], k[4], k[6] or k[2], k[7] or k[5]]
        size = {"width": content.w, "height": content.h, "is_scalable": True}
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = turned_by([row[3], *row[:3]]), row[4:]
        name = f"{folder}/{index}{suffixes.get(str(index), '.jpg')}"
        lens = Lens(fx=own[0], fy=own[1], cx=own[2], cy=own[3], **size)
        shots.append(Shot(name=name, lens=lens, pose=pose))
    return frame_set(path, FORMAT, shots, images=[path.parent / shot.name for shot in shots])
