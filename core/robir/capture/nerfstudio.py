# SPDX-License-Identifier: Apache-2.0
"""nerfstudio and instant-ngp captures: one transforms.json."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from robir.capture import transforms
from robir.capture.frames import Frame, FrameSet, unique_names
from robir.capture.refusal import note, refuse, warning

FORMAT = "nerfstudio"
NAME = "transforms.json"

_TRAINER_FRAMES = ("applied_transform", "applied_scale", "scale", "offset", "orientation_override")


def read(path: Path) -> FrameSet:
    """Read poses, intrinsics, masks and splits.

    Args:
        path: The transforms file.

    Returns:
        Frames with OpenGL poses in the file's own frame.

    Raises:
        CaptureError: If the file is damaged, a key is missing or only some frames have masks.
    """
    content = transforms.load(path)
    entries: list[dict[str, Any]] = content["frames"]
    root = path.parent
    relatives = [transforms.file_path(path, entry, i) for i, entry in enumerate(entries)]
    tests = {
        str(name).removeprefix("./")
        for key in ("test_filenames", "val_filenames")
        for name in content.get(key, [])
    }
    frames = []
    for index, name in enumerate(unique_names(relatives)):
        entry, relative = entries[index], relatives[index]
        where = f"frame {index} ({relative})"
        mask = entry.get("mask_path")
        frames.append(
            Frame(
                name=name,
                image=transforms.image_at(root, relative),
                relative=relative,
                mask=None if mask is None else root / str(mask),
                lens=transforms.lens(path, content, entry, where),
                camera_to_world=transforms.pose(path, entry, where),
                split="test" if relative in tests else "train",
            )
        )
    without = [frame.image.name for frame in frames if frame.mask is None]
    if 0 < len(without) < len(frames):
        raise refuse(
            "missing-masks",
            f'{path}: {len(without)} of {len(frames)} frames have no "mask_path"',
            "Name a mask for every frame, or give all masks with --masks DIR.",
            *without,
        )
    findings = []
    present = [key for key in _TRAINER_FRAMES if key in content]
    if present:
        findings.append(
            note(
                "trainer-frame",
                f"{path.name} holds {', '.join(present)}; poses are kept as the file gives them",
            )
        )
    if any(entry.get("rolling_shutter", content.get("rolling_shutter")) for entry in entries):
        findings.append(
            warning(
                "rolling-shutter",
                f"{path.name} states a rolling shutter, which is not modelled",
                "Expect blurred detail, or photograph with the camera at rest.",
            )
        )
    return FrameSet(root=root, format=FORMAT, frames=tuple(frames), findings=tuple(findings))
