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
from robir.capture.frames import MAX_NUMBER, OPENGL_FROM_OPENCV, Array, FrameSet, Lens, Sphere
from robir.capture.images.regular import regular
from robir.capture.readers.files import children, photographs_in
from robir.capture.readers.shots import Shot, frame_set, with_masks
from robir.capture.refusal import DAMAGED_ARRAYS, refuse

FORMAT = "neus"
NAME = "cameras_sphere.npz"

_MATRIX = "world_mat_"
_SCALE = "scale_mat_"
_MAX_SKEW = 1.0  # largest displacement in pixels by skewed pixel axes that is let pass


def find(source: Path) -> Path | None:
    """The file of cameras in a folder, told by its arrays."""
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
    """Read cameras, the object's sphere and masks.

    Frames in the world frame of `world_mat`.
    """
    root = path.parent
    matrices = _matrices(path)
    folder = next((root / n for n in ("image", "images", "rgb") if (root / n).is_dir()), None)
    photographs = [] if folder is None else photographs_in(folder, root)
    numbers = _numbers(path, photographs, matrices)
    shots = []
    for relative, number in zip(photographs, numbers, strict=True):
        lens, pose = _decomposed(path, relative, matrices[_MATRIX + number])
        shots.append(Shot(name=relative, lens=lens, pose=pose))
    found = frame_set(path, FORMAT, shots, images=[root / shot.name for shot in shots])
    found = replace(found, sphere=_sphere(path, matrices, numbers))
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


def _numbers(path: Path, photographs: list[str], matrices: dict[str, Array]) -> list[str]:
    """Which matrix belongs to which photograph: by order, else by the number in the name."""
    numbers = sorted((k[len(_MATRIX) :] for k in matrices if k.startswith(_MATRIX)), key=_order)
    if len(numbers) == len(photographs):
        return numbers
    by_name = [str(int(s)) if _is_number(s) else "" for s in (Path(p).stem for p in photographs)]
    if photographs and set(by_name) <= set(numbers):
        return by_name
    message = f"{path} has {len(numbers)} cameras, but {path.parent / 'image'} has "
    message += f"{len(photographs)} photographs"
    cure = "Bring all photographs, or number them like the matrices."
    raise refuse("missing-images", message, cure, *photographs)


def _order(number: str) -> tuple[int, str]:
    return (int(number) if _is_number(number) else -1, number)


def _is_number(text: str) -> bool:
    return text.isascii() and text.isdigit() and len(text) < 18


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
    pose = np.eye(4)
    pose[:3, :3] = rotation.T
    pose[:3, 3] = -np.linalg.solve(matrix[:, :3], matrix[:, 3])
    # Skew moves a pixel in proportion to its row; the principal row is near the middle.
    if abs(k[0, 1]) * abs(k[1, 2]) / k[1, 1] > _MAX_SKEW:
        message = f"{path}: the camera of {relative} has skewed pixel axes ({k[0, 1]:.3g} pixels)"
        cure = "Resample the photograph to rectangular pixels."
        raise refuse("camera-model", message, cure, relative)
    lens = Lens(
        fx=float(k[0, 0]), fy=float(k[1, 1]), cx=float(k[0, 2]) + 0.5, cy=float(k[1, 2]) + 0.5
    )
    return lens, pose @ OPENGL_FROM_OPENCV


def _sphere(path: Path, matrices: dict[str, Array], numbers: list[str]) -> Sphere | None:
    """The sphere of `scale_mat`, or None where the archive has no usable one."""
    matrix = matrices.get(_SCALE + numbers[0]) if numbers else None
    if matrix is None or not (np.abs(matrix) < MAX_NUMBER).all():
        return None
    radius = float(np.linalg.norm(matrix[:3, :3], axis=0).max())
    if radius <= 0:
        return None
    return Sphere(
        centre=matrix[:3, 3].copy(),
        radius=radius,
        origin=f"the sphere of {path.name}",
        is_limit=True,
    )
