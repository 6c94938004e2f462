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
from robir.capture.readers.files import photographs_in
from robir.capture.readers.shots import Shot, frame_set, with_masks
from robir.capture.refusal import DAMAGED_ARRAYS, refuse

FORMAT = "llff"
NAME = "poses_bounds.npy"

_MATTED = "images_mask"
_MAX_NUMBERS = 17 * 1_000_000


def read(path: Path) -> FrameSet:
    """Read poses and intrinsics.

    Frames in the file's own frame, rows in order of the names as text; the numeric order is in
    `other_order` where it differs.
    """
    root = path.parent
    rows = _rows(path)
    folder = next((root / n for n in ("images", _MATTED) if (root / n).is_dir()), root)
    photographs = photographs_in(folder, root)
    if len(photographs) != len(rows):
        message = f"{path} has {len(rows)} poses, but {folder} has {len(photographs)} photographs"
        cure = "Bring exactly the photographs the poses were made for."
        raise refuse("missing-images", message, cure, *photographs)
    shots = [
        Shot(name=relative, lens=_lens(path, row), pose=_pose(row))
        for relative, row in zip(photographs, rows, strict=True)
    ]
    found = frame_set(path, FORMAT, shots, images=[root / shot.name for shot in shots])
    frames = found.frames
    if folder.name != _MATTED and (root / _MATTED).is_dir():
        frames = with_masks(root / _MATTED, frames)
    numeric = sorted(range(len(rows)), key=lambda i: natural_order(photographs[i]))
    other = list(frames)
    for row, place in enumerate(numeric):
        other[place] = replace(
            frames[place], camera_to_world=_pose(rows[row]), lens=_lens(path, rows[row])
        )
    is_same = numeric == sorted(numeric)
    return replace(found, frames=frames, other_order=() if is_same else tuple(other))


def _rows(path: Path) -> Array:
    try:
        with regular(path) as file:
            rows = read_matrix(file, _MAX_NUMBERS)
    except DAMAGED_ARRAYS as fault:
        raise refuse(
            "bad-poses", f"{path} is no readable array ({fault})", "Copy it again.", path.name
        ) from None
    if rows.shape[1] != 17:
        message = f"{path} has shape {rows.shape}; a row of 17 numbers for each photograph is "
        message += "needed"
        raise refuse("bad-poses", message, "Write it as LLFF's imgs2poses does.", path.name)
    return rows


def _pose(row: Array) -> Array:
    down, right, back, position = row[:15].reshape(3, 5)[:, :4].T
    pose = np.eye(4)
    pose[:3] = np.stack([right, -down, back, position], axis=1)
    return pose


def _lens(path: Path, row: Array) -> Lens:
    height, width, focal = row[:15].reshape(3, 5)[:, 4]
    if not (1 <= height < MAX_NUMBER and 1 <= width < MAX_NUMBER and 0 < focal < MAX_NUMBER):
        message = f"{path} states {width:g}x{height:g} pixels and a focal length of {focal:g}"
        raise refuse("bad-intrinsics", message, "Estimate the poses again.", path.name)
    return Lens(width=int(width), height=int(height), fx=float(focal), is_scalable=True)
