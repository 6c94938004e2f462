# SPDX-License-Identifier: Apache-2.0
"""LLFF captures: poses_bounds.npy with an images folder.

Each row is a 3x5 matrix and two depths. Its first four columns are camera-to-world with axes
(down, right, backwards), the fifth is (height, width, focal length). Rows follow the photographs
sorted by name, but the file does not say how: "10.jpg" comes before "2.jpg" for some programs and
after it for others. Both orders are handed on where they differ; the masks tell which is right.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from robir.capture.arrays import read_matrix
from robir.capture.frames import MAX_NUMBER, Array, FrameSet, Lens
from robir.capture.images.regular import regular
from robir.capture.masks.given import natural_order
from robir.capture.readers.files import pictures_in
from robir.capture.readers.shots import Shot, frame_set, opengl_pose, with_masks
from robir.capture.refusal import DAMAGED_ARRAYS, refuse

NAME = "poses_bounds.npy"

_MATTED = "images_mask"
_MAX_NUMBERS = 17 * 1_000_000


def read(path: Path) -> FrameSet:
    """Read poses and intrinsics, rows in order of the names as text.

    The numeric order is in `other_order` where it differs.
    """
    root = path.parent
    rows = _rows(path)
    folder = next((root / n for n in ("images", _MATTED) if (root / n).is_dir()), root)
    pictures = pictures_in(folder)
    names = [picture.relative_to(root).as_posix() for picture in pictures]
    if len(pictures) != len(rows):
        message = f"{path} has {len(rows)} poses, but {folder} has {len(pictures)} photographs"
        cure = "Bring exactly the photographs the poses were made for."
        raise refuse("missing-images", message, cure, *names)
    cameras = [_camera(path, row) for row in rows]
    shots = [
        Shot(name=name, image=picture, lens=lens, pose=pose)
        for name, picture, (lens, pose) in zip(names, pictures, cameras, strict=True)
    ]
    found = frame_set(path, "llff", shots)
    frames = found.frames
    if folder.name != _MATTED and (root / _MATTED).is_dir():
        frames = with_masks(root / _MATTED, frames)
    numeric = sorted(range(len(rows)), key=lambda i: natural_order(names[i]))
    other = list(frames)
    for place, (lens, pose) in zip(numeric, cameras, strict=True):
        other[place] = replace(frames[place], camera_to_world=pose, lens=lens)
    is_same = numeric == sorted(numeric)
    return replace(found, frames=frames, other_order=() if is_same else tuple(other))


def _rows(path: Path) -> Array:
    try:
        with regular(path) as file:
            rows = read_matrix(file, _MAX_NUMBERS)
        if rows.shape[1] == 17:
            return rows
    except DAMAGED_ARRAYS as fault:
        message, cure = f"{path} is no readable array ({fault})", "Copy it again."
    else:
        message = f"{path} has shape {rows.shape}; a row of 17 numbers a photograph is needed"
        cure = "Write it as LLFF's imgs2poses does."
    raise refuse("bad-poses", message, cure, path.name)


def _camera(path: Path, row: Array) -> tuple[Lens, Array]:
    """Intrinsics and camera-to-world."""
    down, right, back, position, (height, width, focal) = row[:15].reshape(3, 5).T
    if not (1 <= height < MAX_NUMBER and 1 <= width < MAX_NUMBER and 0 < focal < MAX_NUMBER):
        message = f"{path} states {width:g}x{height:g} pixels and a focal length of {focal:g}"
        raise refuse("bad-intrinsics", message, "Estimate the poses again.", path.name)
    lens = Lens(width=int(width), height=int(height), fx=float(focal), is_scalable=True)
    return lens, opengl_pose(np.stack([right, -down, back], axis=1), position)
