# SPDX-License-Identifier: Apache-2.0
"""Cameras as a program lists them, and what makes frames of them: photographs found, names unique.

Poses are handed on as camera-to-world with OpenGL axes. The helpers take what is not finite as it
comes: such a pose is named with its photograph later.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
import numpy as np
from msgspec import Meta

from robir.capture.capture import Finding
from robir.capture.frames import (
    MAX_NUMBER,
    Array,
    Frame,
    FrameSet,
    Lens,
    checked_lens,
    unique_names,
)
from robir.capture.masks.given import from_folder
from robir.capture.readers.files import locate_photographs
from robir.capture.refusal import note, refuse, warning

# a position, or three numbers that say how something is turned
Vector = Annotated[list[float], Meta(min_length=3, max_length=3)]


@dataclass(frozen=True, slots=True, kw_only=True)
class Shot:
    """A posed photograph, not yet looked for.

    Attributes:
        name: Name or path of the photograph as the program writes it, with or without suffix.
        lens: Intrinsics as stated.
        pose: Camera-to-world, (4, 4), OpenGL axes.
        mask: Path of its mask as the program writes it, or None.
        split: "test" if the program keeps it aside.
    """

    name: str
    lens: Lens
    pose: Array
    mask: str | None = None
    split: Literal["train", "test"] = "train"


def frame_set(
    path: Path,
    form: str,
    shots: Sequence[Shot],
    *,
    images: Sequence[Path] | None = None,
    points: Array | None = None,
    findings: Sequence[Finding] = (),
) -> FrameSet:
    """Find the photographs that cameras name, and name the frames.

    Args:
        path: File of poses.
        form: Name of the format.
        shots: Its cameras.
        images: Where the photographs lie if names are paths; they are looked for by name if none
            of these is there, as for a file from another machine.
        points: Sparse points, (N, 3), capture frame, or None.
        findings: What the reader noticed.
    """
    if not shots:
        message = f"{path} holds no camera with a pose"
        cure = "Let the program that wrote it find the cameras, and export them again."
        raise refuse("no-poses", message, cure, path.name)
    found = list(findings)
    stated = [shot.name for shot in shots]
    root, relatives = path.parent, stated
    if images is None or not any(map(is_file, images)):
        root, relatives = locate_photographs(path, stated)
        placed = [
            Path(name) if Path(name).is_absolute() and is_file(Path(name)) else None
            for name in stated
        ]
        if images is not None and any(is_file(root / relative) for relative in relatives):
            message = f"No photograph lies where {path.name} says; they were found by their names"
            found.append(note("found-by-name", message, *relatives))
        images = [there or root / below for there, below in zip(placed, relatives, strict=True)]
    frames = tuple(
        Frame(
            name=name,
            image=image,
            relative=relative,
            mask=None if shot.mask is None else _mask(root, shot.mask),
            lens=checked_lens(shot.lens, path, shot.name[:80]),
            camera_to_world=shot.pose,
            split=shot.split,
        )
        for shot, image, relative, name in zip(
            shots, images, relatives, unique_names(relatives), strict=True
        )
    )
    cloud = np.zeros((0, 3)) if points is None else points
    return FrameSet(root=root, format=form, frames=frames, points=cloud, findings=tuple(found))


def with_masks(folder: Path, frames: Sequence[Frame]) -> tuple[Frame, ...]:
    """Frames with the masks that a folder holds for them."""
    masks = from_folder(folder, frames)
    return tuple(replace(frame, mask=masks[frame.name]) for frame in frames)


def is_file(path: Path) -> bool:
    """Whether a file is there; a name that no file can have is not."""
    try:
        return path.is_file()
    except OSError:
        return False


def _mask(root: Path, stated: str) -> Path:
    """A mask where it is stated to be, or in the folder of that name here."""
    parts = stated.replace("\\", "/").split("/")
    here = root.joinpath(*parts[-2:])
    is_moved = not is_file(root / stated) and is_file(here)
    return here if is_moved else root / stated


def rolling_shutter(path: Path) -> Finding:
    """The warning that a file states a rolling shutter."""
    message = f"{path.name} states a rolling shutter, which is not modelled"
    cure = "Expect blurred detail, or photograph with the camera at rest."
    return warning("rolling-shutter", message, cure)


def opencv_pose(rotation: Any, position: Any) -> Array:
    """Our pose from a camera-to-world rotation (3, 3) with OpenCV axes and a position (3,)."""
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, position
    pose[:, 1:3] *= -1.0  # a product of matrices would spread what is not finite
    return pose


def opencv_view(rotation: Any, translation: Any) -> Array:
    """Our pose from what carries the world into a camera with OpenCV axes."""
    back = np.asarray(rotation, dtype=np.float64).T
    with np.errstate(all="ignore"):
        return opencv_pose(back, -back @ np.asarray(translation))


def turned_by(quaternion: Sequence[float]) -> Array:
    """Rotation (3, 3) of a quaternion of any length, w first; NaN where it is none."""
    with np.errstate(all="ignore"):
        w, x, y, z = np.array(quaternion) / np.linalg.norm(quaternion)
        return np.array(
            [
                [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
            ]
        )


def sane_points(plain: Any) -> Array:
    """Sparse points, (N, 3), of a list of positions; none if damaged, for they only help."""
    try:
        points = np.array(msgspec.convert(plain, list[Vector], strict=False), dtype=np.float64)
    except (msgspec.ValidationError, RecursionError, UnicodeEncodeError, OverflowError):
        return np.zeros((0, 3))
    points = points.reshape(-1, 3)
    return points[(np.abs(points) < MAX_NUMBER).all(axis=1)]
