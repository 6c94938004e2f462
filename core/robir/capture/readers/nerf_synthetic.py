# SPDX-License-Identifier: Apache-2.0
"""NeRF-synthetic captures: transforms_train.json with transforms_test.json beside it."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from robir.capture.frames import Array, Frame, FrameSet, Lens, unique_names
from robir.capture.readers import transforms

FORMAT = "nerf-synthetic"
TRAIN = "transforms_train.json"


def read(root: Path) -> FrameSet:
    """Read poses and intrinsics; test views come from the test file, else the val file.

    Args:
        root: Folder with transforms_train.json.

    Returns:
        Frames with OpenGL poses in the files' own frame.

    Raises:
        CaptureError: If a file is damaged or a key is missing.
    """
    entries = _entries(root, TRAIN, "train")
    for name in ("transforms_test.json", "transforms_val.json"):
        if (root / name).is_file():
            entries += _entries(root, name, "test")
            break
    names = unique_names([relative for _, relative, _, _ in entries])
    photographs = transforms.Photographs(root)
    frames = tuple(
        Frame(
            name=name,
            image=photographs.at(relative),
            relative=relative,
            lens=lens,
            camera_to_world=pose,
            split=split,
        )
        for name, (split, relative, lens, pose) in zip(names, entries, strict=True)
    )
    return FrameSet(root=root, format=FORMAT, frames=frames)


def _entries(
    root: Path, name: str, split: Literal["train", "test"]
) -> list[tuple[Literal["train", "test"], str, Lens, Array]]:
    path = root / name
    content = transforms.load(path)
    result = []
    for index, entry in enumerate(content.frames):
        relative = transforms.file_path(path, entry, index)
        where = f"frame {index} ({relative})"
        lens = transforms.lens(path, content, entry, where)
        result.append((split, relative, lens, transforms.pose(path, entry, where)))
    return result
