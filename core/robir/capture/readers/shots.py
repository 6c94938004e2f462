# SPDX-License-Identifier: Apache-2.0
"""Cameras as a program lists them, and what makes frames of them: photographs found, names unique.

Poses are handed on as camera-to-world with OpenGL axes. The helpers take what is not finite as it
comes: such a pose is named with its photograph later.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from scipy.spatial.transform import Rotation

from robir.capture.capture import Finding
from robir.capture.frames import Array, Frame, FrameSet, Lens, checked_lens, unique_names
from robir.capture.masks.given import from_folder
from robir.capture.readers.files import locate_photographs
from robir.capture.refusal import note, refuse, warning


@dataclass(frozen=True, slots=True, kw_only=True)
class Shot:
    """A posed photograph, not yet looked for."""

    name: str  # name or path of the photograph as the program writes it, with or without suffix
    lens: Lens  # intrinsics as stated
    pose: Array  # camera-to-world, (4, 4), OpenGL axes
    image: Path | None = None  # where it lies, or None to look for it by name
    mask: str | None = None  # path of its mask as the program writes it, or None
    split: Literal["train", "test"] = "train"  # "test" if the program holds it out


def frame_set(
    path: Path,
    form: str,
    shots: Sequence[Shot],
    findings: Sequence[Finding] = (),
    points: Array | None = None,
) -> FrameSet:
    """Frames of the photographs that cameras name, looked for by name if none is where stated."""
    if not shots:
        message = f"{path} holds no camera with a pose"
        cure = "Let the program that wrote it find the cameras, and export them again."
        raise refuse("no-poses", message, cure, path.name)
    found = list(findings)
    stated = [shot.name for shot in shots]
    images = [shot.image for shot in shots if shot.image is not None]
    root, relatives = path.parent, stated
    if not any(map(is_file, images)):
        root, relatives = locate_photographs(path, stated)
        if images and any(is_file(root / relative) for relative in relatives):
            message = f"No photograph lies where {path.name} says; they were found by their names"
            found.append(note("found-by-name", message, *relatives))
        placed = [Path(name) for name in stated]
        images = [
            there if there.is_absolute() and is_file(there) else root / below
            for there, below in zip(placed, relatives, strict=True)
        ]
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
    here = root.joinpath(*stated.replace("\\", "/").split("/")[-2:])
    return here if not is_file(root / stated) and is_file(here) else root / stated


def rolling_shutter(path: Path) -> Finding:
    """The warning that a file states a rolling shutter."""
    message = f"{path.name} states a rolling shutter, which is not modelled"
    cure = "Expect blurred detail, or photograph with the camera at rest."
    return warning("rolling-shutter", message, cure)


def opengl_pose(rotation: Any, position: Any) -> Array:
    """Our pose from a camera-to-world rotation (3, 3) with OpenGL axes and a position (3,)."""
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, position
    return pose


def opencv_pose(rotation: Any, position: Any) -> Array:
    """The same of a rotation with OpenCV axes."""
    pose = opengl_pose(rotation, position)
    pose[:, 1:3] *= -1.0  # a product of matrices would spread what is not finite
    return pose


def opencv_view(rotation: Any, translation: Any) -> Array:
    """Our pose from what carries the world into a camera with OpenCV axes."""
    back = np.asarray(rotation, dtype=np.float64).T
    with np.errstate(all="ignore"):
        return opencv_pose(back, -back @ np.asarray(translation))


def turned_by(quaternion: Sequence[float]) -> Array:
    """Rotation (3, 3) of a quaternion of any length, w first; NaN where it is none."""
    w, *axis = quaternion
    if not 0 < np.linalg.norm(quaternion) < np.inf:
        return np.full((3, 3), np.nan)
    return Rotation.from_quat([*axis, w]).as_matrix()
