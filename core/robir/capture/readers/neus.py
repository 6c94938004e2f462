# SPDX-License-Identifier: Apache-2.0
"""NeuS and IDR captures: cameras_sphere.npz with image and mask folders.

`world_mat_i` projects homogeneous world points to pixels, K [R | t] with OpenCV axes, and
`scale_mat_i` carries the unit sphere onto the sphere about the object. Poses stay in the world
frame. The format counts pixels from the centre of the first one, so half a pixel is added.
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
from robir.capture.images.regular import regular
from robir.capture.readers.files import children, pictures_in
from robir.capture.readers.shots import Shot, frame_set, opencv_pose, with_masks
from robir.capture.refusal import DAMAGED_ARRAYS, refuse

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
