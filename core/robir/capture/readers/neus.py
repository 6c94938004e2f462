# SPDX-License-Identifier: Apache-2.0
"""Cameras in numpy's files: cameras_sphere.npz of NeuS and IDR, poses_bounds.npy of LLFF.

`world_mat_i` projects homogeneous world points to pixels, K [R | t] with OpenCV axes, and
`scale_mat_i` carries the unit sphere onto the sphere about the object. Poses stay in the world
frame. The format counts pixels from the centre of the first one, so half a pixel is added.

A row of LLFF is a 3x5 matrix and two depths. Its first four columns are camera-to-world with axes
(down, right, backwards), the fifth is (height, width, focal length). Rows follow the photographs
sorted by name, but the file does not say how: "10.jpg" comes before "2.jpg" for some programs and
after it for others. Both orders are handed on where they differ; the masks tell which is right.
"""

from __future__ import annotations

import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy import linalg

from robir.capture.arrays import read_matrix
from robir.capture.capture import Bounds
from robir.capture.frames import MAX_NUMBER, Array, FrameSet, Lens
from robir.capture.masks.given import natural_order
from robir.capture.readers.files import children, pictures_in
from robir.capture.readers.shots import Shot, frame_set, opencv_pose, opengl_pose, with_masks
from robir.capture.refusal import DAMAGED_ARRAYS, refuse
from robir.jobs.names import regular

NAME = "cameras_sphere.npz"

_MATRIX, _SCALE = "world_mat_", "scale_mat_"
_MAX_SKEW = 1.0  # largest displacement in pixels by skewed pixel axes that is let pass


def find(source: Path) -> Path | None:
    """The file of cameras in a folder, recognised by its arrays."""
    archives = [path for path in children(source) if path.suffix == ".npz"]
    for path in sorted(archives, key=lambda path: path.name != NAME):
        if path.name == NAME or path.name.startswith("cameras") or is_camera_file(path):
            return path
    return None


def is_camera_file(path: Path) -> bool:
    """Whether an archive holds projection matrices."""
    try:
        with regular(path) as file, zipfile.ZipFile(file) as archive:
            return any(name.startswith(_MATRIX) for name in archive.namelist())
    except DAMAGED_ARRAYS:
        return False


def read(path: Path) -> FrameSet:
    """Read cameras, the object's sphere and masks, in the world frame of `world_mat`."""
    root = path.parent
    matrices = _matrices(path)
    folder = next((root / n for n in ("image", "images", "rgb") if (root / n).is_dir()), None)
    pictures = [] if folder is None else pictures_in(folder)
    numbers = _numbers(path, [picture.name for picture in pictures], matrices)
    shots = []
    for picture, number in zip(pictures, numbers, strict=True):
        name = picture.relative_to(root).as_posix()
        lens, pose = _decomposed(path, name, matrices[_MATRIX + number])
        shots.append(Shot(name=name, image=picture, lens=lens, pose=pose))
    found = replace(frame_set(path, "neus", shots), sphere=_sphere(path, matrices, numbers))
    drawn = next((root / n for n in ("mask", "masks") if (root / n).is_dir()), None)
    return found if drawn is None else replace(found, frames=with_masks(drawn, found.frames))


def _matrices(path: Path) -> dict[str, Array]:
    try:
        found = {}
        with regular(path) as file, zipfile.ZipFile(file) as archive:
            for member in archive.namelist():
                key = member.removesuffix(".npy")
                if key.startswith((_MATRIX, _SCALE)) and "_inv_" not in key:
                    with archive.open(member) as stored:
                        found[key] = read_matrix(stored, 16)
    except DAMAGED_ARRAYS as fault:
        message = f"{path} is no readable archive of camera matrices ({fault})"
        raise refuse("bad-cameras", message, "Copy it again.", path.name) from None
    odd = [key for key, matrix in found.items() if matrix.shape not in ((4, 4), (3, 4))]
    if odd or not any(key.startswith(_MATRIX) for key in found):
        what = f"{odd[0]} is no 4x4 matrix" if odd else 'the key "world_mat_0" is missing'
        raise refuse("bad-cameras", f"{path}: {what}", "Write it as NeuS does.", path.name)
    return found


def _numbers(path: Path, pictures: list[str], matrices: dict[str, Array]) -> list[str]:
    """Which matrix belongs to which photograph: by order, else by the number in the name."""
    keys = [key[len(_MATRIX) :] for key in matrices if key.startswith(_MATRIX)]
    numbers = sorted(keys, key=lambda key: (int(_plain(key) or -1), key))
    if len(numbers) == len(pictures):
        return numbers
    by_name = [_plain(Path(picture).stem) for picture in pictures]
    if pictures and set(by_name) <= set(numbers):
        return by_name
    message = f"{path} has {len(numbers)} cameras, but {path.parent / 'image'} has "
    message += f"{len(pictures)} photographs"
    cure = "Bring all photographs, or number them like the matrices."
    raise refuse("missing-images", message, cure, *pictures)


def _plain(text: str) -> str:
    """A number without leading zeros; nothing where the text is none."""
    return str(int(text)) if text.isascii() and text.isdigit() and len(text) < 18 else ""


def _decomposed(path: Path, relative: str, matrix: Array) -> tuple[Lens, Array]:
    """Intrinsics and camera-to-world of a projection; a pose of NaN or zeros if it is none."""
    matrix = matrix[:3]
    left = matrix[:, :3]
    if not np.isfinite(matrix).all() or np.abs(matrix).max() > MAX_NUMBER:
        return Lens(angle_x=1.0), np.full((4, 4), np.nan)
    scale = np.linalg.norm(left, axis=1).max()
    if scale == 0 or abs(np.linalg.det(left / scale)) < 1e-12:
        return Lens(angle_x=1.0), np.zeros((4, 4))
    if np.linalg.det(left) < 0:
        matrix = -matrix
    k, rotation = linalg.rq(matrix[:, :3])
    signs = np.diag(np.sign(np.diag(k)))
    k, rotation = k @ signs, signs @ rotation
    k = k / k[2, 2]
    # Skew moves a pixel in proportion to its row; the principal row is near the middle.
    if abs(k[0, 1]) * abs(k[1, 2]) / k[1, 1] > _MAX_SKEW:
        message = f"{path}: the camera of {relative} has skewed pixel axes ({k[0, 1]:.3g} pixels)"
        cure = "Resample the photograph to rectangular pixels."
        raise refuse("camera-model", message, cure, relative)
    fx, fy, cx, cy = (float(k[place]) for place in ((0, 0), (1, 1), (0, 2), (1, 2)))
    position = -np.linalg.solve(matrix[:, :3], matrix[:, 3])
    return Lens(fx=fx, fy=fy, cx=cx + 0.5, cy=cy + 0.5), opencv_pose(rotation.T, position)


def _sphere(path: Path, matrices: dict[str, Array], numbers: list[str]) -> Bounds | None:
    """The sphere of `scale_mat`, or None where the archive has no usable one."""
    matrix = matrices.get(_SCALE + numbers[0]) if numbers else None
    if matrix is None or not (np.abs(matrix) < MAX_NUMBER).all():
        return None
    radius = float(np.linalg.norm(matrix[:3, :3], axis=0).max())
    origin = f"the sphere of {path.name}"
    centre = matrix[:3, 3].copy()
    return Bounds(centre=centre, radius=radius, origin=origin, is_limit=True) if radius else None


LLFF = "poses_bounds.npy"

_MATTED = "images_mask"
_MAX_NUMBERS = 17 * 1_000_000


def read_llff(path: Path) -> FrameSet:
    """Poses and intrinsics of LLFF by names as text; by number in `other_order` if that differs."""
    root = path.parent
    rows = _llff_rows(path)
    folder = next((root / n for n in ("images", _MATTED) if (root / n).is_dir()), root)
    pictures = pictures_in(folder)
    names = [picture.relative_to(root).as_posix() for picture in pictures]
    if len(pictures) != len(rows):
        message = f"{path} has {len(rows)} poses, but {folder} has {len(pictures)} photographs"
        cure = "Bring exactly the photographs the poses were made for."
        raise refuse("missing-images", message, cure, *names)
    cameras = [_llff_camera(path, row) for row in rows]
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


def _llff_rows(path: Path) -> Array:
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


def _llff_camera(path: Path, row: Array) -> tuple[Lens, Array]:
    down, right, back, position, (height, width, focal) = row[:15].reshape(3, 5).T
    if not (1 <= height < MAX_NUMBER and 1 <= width < MAX_NUMBER and 0 < focal < MAX_NUMBER):
        message = f"{path} states {width:g}x{height:g} pixels and a focal length of {focal:g}"
        raise refuse("bad-intrinsics", message, "Estimate the poses again.", path.name)
    lens = Lens(width=int(width), height=int(height), fx=float(focal), is_scalable=True)
    return lens, opengl_pose(np.stack([right, -down, back], axis=1), position)
