# SPDX-License-Identifier: Apache-2.0
"""nerfstudio and instant-ngp captures: one transforms.json.

nerfstudio's converters turn and scale the world of the program that found the poses and say so:
with A the 3x4 "applied_transform" and s the "applied_scale", a point p of that program lies at
s A (p, 1) in the file (nerfstudio_dataparser.py: `transform_matrix @ applied_transform`,
`scale_factor *= applied_scale`). Both are undone here, so that the result stands where the
capture's own point cloud does. What trainers apply on loading ("scale", "offset", "aabb_scale",
"orientation_override") has not been applied to the file's poses and is left alone.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from robir.capture.frames import MAX_NUMBER, Array, FrameSet
from robir.capture.readers import transforms
from robir.capture.readers.shots import frame_set, rolling_shutter
from robir.capture.readers.transforms import Transforms
from robir.capture.refusal import note, refuse

FORMAT = "nerfstudio"
NAME = "transforms.json"

_APPLIED = ("applied_transform", "applied_scale")


def read(path: Path) -> FrameSet:
    """Read poses, intrinsics, masks and splits.

    Args:
        path: The transforms file.

    Returns:
        Frames with OpenGL poses in the frame from before `applied_transform`.

    Raises:
        CaptureError: If the file is damaged, a key is missing or only some frames have masks.
    """
    content = transforms.load(path)
    undo = _undoing(path, content)
    shots, findings = transforms.shots(path, content)
    shots = [replace(shot, pose=undo(shot.pose)) for shot in shots]
    without = [shot.name for shot in shots if shot.mask is None]
    if 0 < len(without) < len(shots):
        raise refuse(
            "missing-masks",
            f'{path}: {len(without)} of {len(shots)} frames have no "mask_path"',
            "Name a mask for every frame, or give all masks with --masks DIR.",
            *without,
        )
    applied = [key for key in _APPLIED if getattr(content, key) is not None]
    if applied:
        findings.append(
            note(
                "applied-transform",
                f"{path.name} holds {' and '.join(applied)}; poses were taken back to the frame "
                "and unit from before",
            )
        )
    if content.rolling_shutter or any(entry.rolling_shutter for entry in content.frames):
        findings.append(rolling_shutter(path))
    images = transforms.images(path.parent, shots)
    return frame_set(path, FORMAT, shots, images=images, findings=findings)


def _undoing(path: Path, content: Transforms) -> Callable[[Array], Array]:
    """What takes a camera-to-world matrix of the file back to the frame before the transform."""
    scale = 1.0 if content.applied_scale is None else content.applied_scale
    rows = np.eye(4).tolist() if content.applied_transform is None else content.applied_transform
    is_matrix = len(rows) in (3, 4) and all(len(row) == 4 for row in rows)
    applied = np.array(rows if is_matrix else np.zeros((4, 4)), dtype=np.float64)
    is_sane = bool((np.abs(applied) < MAX_NUMBER).all()) and 0 < scale < MAX_NUMBER
    turn = applied[:3, :3] if is_sane else np.zeros((3, 3))
    size = float(np.cbrt(np.linalg.det(turn)))
    good = size > 1e-9 and np.allclose(turn @ turn.T, size * size * np.eye(3), atol=1e-4 * size**2)
    if not good:
        raise refuse(
            "bad-transform",
            f'{path}: "applied_transform" and "applied_scale" do not turn, scale and move space',
            "Write a 3x4 matrix without shear or mirror, and a positive number; "
            "or leave both out to keep the poses as the file gives them.",
            path.name,
        )

    def undo(pose: Array) -> Array:
        original = np.eye(4)
        with np.errstate(invalid="ignore", over="ignore"):  # poses without finite numbers go later
            original[:3, :3] = turn.T @ pose[:3, :3] / size
            original[:3, 3] = turn.T @ (pose[:3, 3] / scale - applied[:3, 3]) / size**2
        return original

    return undo
