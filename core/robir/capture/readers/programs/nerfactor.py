# SPDX-License-Identifier: Apache-2.0
"""NeRFactor and TensoIR: folders train_000, train_001, ... with metadata.json and rgba.png.

"cam_transform_mat" is camera-to-world as sixteen numbers, row by row, with Blender's axes, which
are ours; "cam_angle_x" the horizontal field of view. TensoIR renders each view under several lights
(rgba_sunset.png, ...): those of one light are read.
"""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Annotated

import msgspec
import numpy as np
from msgspec import Meta

from robir.capture.frames import FrameSet, Lens
from robir.capture.readers.files import children, head, load_json
from robir.capture.readers.shots import Shot, frame_set
from robir.capture.readers.values import Positive, Side, checked
from robir.capture.refusal import note

FORMAT = "nerfactor"

_NAME = "metadata.json"
_CURE = "Render the view again, or remove its folder."
_Row = Annotated[list[float], Meta(min_length=16, max_length=16)]


class _View(msgspec.Struct):
    cam_angle_x: Positive
    cam_transform_mat: str
    imw: Side
    imh: Side


def find(source: Path) -> bool:
    """Whether a folder holds such views."""
    first = next((child for child in children(source) if child.name.startswith("train_")), None)
    return first is not None and '"cam_transform_mat"' in head(first / _NAME)


def read(source: Path) -> FrameSet:
    """Read views to learn from, and those to test with, or to validate, that have photographs."""
    folders = {
        split: [c for c in children(source) if c.name.startswith(split) and (c / _NAME).is_file()]
        for split in ("train_", "test_", "val_")
    }
    pictures = {
        folder: [path.name for path in children(folder) if path.name.startswith("rgba")]
        for views in folders.values()
        for folder in views
    }
    counts = Counter(name for folder in folders["train_"] for name in pictures[folder])
    light = max(counts, key=lambda name: (counts[name], name == "rgba.png"), default="rgba.png")
    tests = next((folders[k] for k in ("test_", "val_") if _have(folders[k], pictures, light)), [])
    shots = [_shot(folder, light) for folder in (*folders["train_"], *tests)]
    findings = []
    if len(counts) > 1:
        others = [name for name in counts if name != light]
        message = f"Of {len(counts)} pictures a view, {light} is read: one object, one light"
        findings.append(note("several-lights", message, *others))
    images = [source / shot.name for shot in shots]
    return frame_set(source / _NAME, FORMAT, shots, images=images, findings=findings)


def _have(folders: list[Path], pictures: dict[Path, list[str]], light: str) -> bool:
    return any(light in pictures[folder] for folder in folders)


def _shot(folder: Path, light: str) -> Shot:
    path = folder / _NAME
    view: _View = checked(path, load_json(path), _View, _CURE)
    words = view.cam_transform_mat.split(",")
    row = checked(path, words, _Row, _CURE, where="cam_transform_mat", is_text=True)
    return Shot(
        name=f"{folder.name}/{light}",
        lens=Lens(width=view.imw, height=view.imh, angle_x=view.cam_angle_x),
        pose=np.array(row).reshape(4, 4),
        split="train" if folder.name.startswith("train_") else "test",
    )
