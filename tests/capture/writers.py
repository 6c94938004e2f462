# SPDX-License-Identifier: Apache-2.0
"""The one test scene written in every format that is read."""

from __future__ import annotations

import json
import struct
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from capture.scene import CENTRE, Shot, surface_points
from PIL import Image
from scipy.spatial.transform import Rotation

FLIP = np.diag([1.0, -1.0, -1.0, 1.0])
# world transform that nerfstudio's converter applied, before a scale of 0.3
APPLIED = np.array([[0.0, 1.0, 0.0, 0.2], [1.0, 0.0, 0.0, -4.0], [0.0, 0.0, -1.0, 1.5]])


def save_pictures(folder: Path, shots: Sequence[Shot], names: Sequence[str], alpha: bool) -> None:
    """Photographs as PNG; without alpha on a mid-grey background."""
    folder.mkdir(parents=True, exist_ok=True)
    for shot, name in zip(shots, names, strict=True):
        picture = shot.rgba
        if not alpha:
            share = picture[:, :, 3:] / 255.0
            picture = np.rint(picture[:, :, :3] * share + 90 * (1 - share)).astype(np.uint8)
        Image.fromarray(picture).save(folder / name)


def save_masks(folder: Path, shots: Sequence[Shot], names: Sequence[str]) -> None:
    """Masks as grey PNG."""
    folder.mkdir(parents=True, exist_ok=True)
    for shot, name in zip(shots, names, strict=True):
        Image.fromarray(np.ascontiguousarray(shot.rgba[:, :, 3])).save(folder / name)


def nerf_synthetic(root: Path, shots: Sequence[Shot], tests: int = 0) -> Path:
    """The last `tests` shots become the test split."""
    first = len(shots) - tests
    for split, part in (("train", shots[:first]), ("test", shots[first:])):
        if not part:
            continue
        save_pictures(root / split, part, [f"r_{i}.png" for i in range(len(part))], alpha=True)
        lens = part[0].camera
        content = {
            "camera_angle_x": 2 * np.arctan(0.5 * lens.width / lens.fx),
            "frames": [
                {
                    "file_path": f"./{split}/r_{i}",
                    "transform_matrix": shot.camera.camera_to_world.tolist(),
                }
                for i, shot in enumerate(part)
            ],
        }
        (root / f"transforms_{split}.json").write_text(json.dumps(content))
    return root


def applied(pose: np.ndarray) -> np.ndarray:
    """A pose as nerfstudio's converters turn and scale it."""
    result = np.eye(4)
    result[:3] = APPLIED @ pose
    result[:3, 3] *= 0.3
    return result


def nerfstudio(root: Path, shots: Sequence[Shot], per_frame: bool = False) -> Path:
    """Photographs with mask_path; intrinsics shared or in every frame."""
    names = [f"frame_{i:05d}.png" for i in range(len(shots))]
    save_pictures(root / "images", shots, names, alpha=False)
    save_masks(root / "mattes", shots, names)
    lens = shots[0].camera
    keys = {
        "fl_x": lens.fx,
        "fl_y": lens.fy,
        "cx": lens.cx,
        "cy": lens.cy,
        "w": lens.width,
        "h": lens.height,
    }
    content = {
        "camera_model": "OPENCV",
        "applied_transform": APPLIED.tolist(),
        "applied_scale": 0.3,
        "scale": 0.5,
        "offset": [1, 2, 3],
        "aabb_scale": 16,
        "orientation_override": "up",
        "frames": [],
    }
    content |= {} if per_frame else keys
    for shot, name in zip(shots, names, strict=True):
        content["frames"].append(
            {
                "file_path": f"images/{name}",
                "mask_path": f"mattes/{name}",
                "transform_matrix": applied(shot.camera.camera_to_world).tolist(),
            }
            | (keys if per_frame else {})
        )
    (root / "transforms.json").write_text(json.dumps(content))
    return root


def colmap(
    root: Path, shots: Sequence[Shot], binary: bool, folder: str = "sparse/0", tail: str = ""
) -> Path:
    """Sparse model with points, photographs and masks named like COLMAP's (`x.png.png`)."""
    names = [f"IMG_{7 * i:03d}{tail}.png" for i in range(len(shots))]
    save_pictures(root / "images", shots, names, alpha=False)
    save_masks(root / "masks", shots, [f"{name}.png" for name in names])
    model = root / folder
    model.mkdir(parents=True, exist_ok=True)
    poses = []
    for shot in shots:
        world_to_camera = np.linalg.inv(shot.camera.camera_to_world @ FLIP)
        x, y, z, w = Rotation.from_matrix(world_to_camera[:3, :3]).as_quat()
        poses.append([w, x, y, z, *world_to_camera[:3, 3]])
    points = surface_points(600)
    write = _colmap_binary if binary else _colmap_text
    write(model, shots[0].camera, names, poses, points)
    return root


def _colmap_text(model: Path, lens, names, poses, points) -> None:
    parameters = f"{lens.fx!r} {lens.fy!r} {lens.cx!r} {lens.cy!r}"
    (model / "cameras.txt").write_text(
        f"# Camera list\n3 PINHOLE {lens.width} {lens.height} {parameters}\n"
    )
    lines = ["# Image list"]
    for i, (name, pose) in enumerate(zip(names, poses, strict=True)):
        lines += [f"{i + 5} {' '.join(map(repr, map(float, pose)))} 3 {name}", "1.0 2.0 -1"]
    lines[2] = ""  # a photograph without observations
    (model / "images.txt").write_text("\n".join(lines) + "\n")
    (model / "points3D.txt").write_text(
        "".join(f"{i} {x} {y} {z} 9 9 9 0.5 1 2\n" for i, (x, y, z) in enumerate(points))
    )


def _colmap_binary(model: Path, lens, names, poses, points) -> None:
    with (model / "cameras.bin").open("wb") as file:
        file.write(
            struct.pack(
                "<QiiQQ4d", 1, 3, 1, lens.width, lens.height, lens.fx, lens.fy, lens.cx, lens.cy
            )
        )
    with (model / "images.bin").open("wb") as file:
        file.write(struct.pack("<Q", len(names)))
        for i, (name, pose) in enumerate(zip(names, poses, strict=True)):
            file.write(struct.pack("<i7di", i + 5, *pose, 3) + name.encode() + b"\0")
            file.write(struct.pack("<Q", i % 2) + (i % 2) * struct.pack("<ddq", 1.0, 2.0, -1))
    with (model / "points3D.bin").open("wb") as file:
        file.write(struct.pack("<Q", len(points)))
        for i, point in enumerate(points):
            file.write(struct.pack("<Q3d3BdQii", i, *point, 9, 9, 9, 0.5, 1, 5, 0))


def neus(root: Path, shots: Sequence[Shot]) -> Path:
    """Projection matrices that count pixels from the first one's centre; masks of their own."""
    save_pictures(root / "image", shots, [f"{i:06d}.png" for i in range(len(shots))], alpha=False)
    save_masks(root / "mask", shots, [f"{i:03d}.png" for i in range(len(shots))])
    arrays = {}
    for i, shot in enumerate(shots):
        lens = shot.camera
        k = np.array([[lens.fx, 0, lens.cx - 0.5], [0, lens.fy, lens.cy - 0.5], [0, 0, 1]])
        world = np.eye(4)
        # The scale of a projection means nothing; a negative one checks the sign.
        world[:3] = -0.37 * k @ np.linalg.inv(lens.camera_to_world @ FLIP)[:3]
        scale = np.diag([1.5, 1.5, 1.5, 1.0])
        scale[:3, 3] = CENTRE + 0.1
        arrays |= {
            f"world_mat_{i}": world,
            f"scale_mat_{i}": scale,
            f"world_mat_inv_{i}": np.linalg.inv(world),
        }
    np.savez(root / "cameras_sphere.npz", **arrays)
    return root


def llff(root: Path, shots: Sequence[Shot], numeric: bool, matted: bool = True) -> Path:
    """Names 8.png, 9.png, 10.png ...; rows in numeric order or in order of the text."""
    names = [f"{i + 8}.png" for i in range(len(shots))]
    save_pictures(root / "images", shots, names, alpha=False)
    if matted:
        matte = [f"{i + 8}-removebg-preview.png" for i in range(len(shots))]
        save_pictures(root / "images_mask", shots, matte, alpha=True)
    order = range(len(shots)) if numeric else np.argsort(names)
    rows = []
    for i in order:
        lens = shots[i].camera
        right, up, back, position = lens.camera_to_world[:3].T
        matrix = np.stack([-up, right, back, position, [lens.height, lens.width, lens.fx]], axis=1)
        rows.append([*matrix.ravel(), 1.0, 9.0])
    np.save(root / "poses_bounds.npy", np.array(rows))
    return root
