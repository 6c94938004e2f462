# SPDX-License-Identifier: Apache-2.0
"""NeRF-synthetic captures: transforms_train.json with transforms_test.json beside it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from robir.capture.frames import FrameSet
from robir.capture.readers import transforms
from robir.capture.readers.shots import frame_set, is_file
from robir.capture.refusal import note

FORMAT = "nerf-synthetic"
TRAIN = "transforms_train.json"


def read(root: Path) -> FrameSet:
    """Read poses and intrinsics; test views come from the test file, else the val file.

    A test file whose photographs are all absent holds cameras to be rendered, as BlenderNeRF writes
    it, and is left out.

    Args:
        root: Folder with transforms_train.json.

    Returns:
        Frames with OpenGL poses in the files' own frame.

    Raises:
        CaptureError: If a file is damaged or a key is missing.
    """
    path = root / TRAIN
    shots, findings = transforms.shots(path, transforms.load(path))
    tests = [root / name for name in ("transforms_test.json", "transforms_val.json")]
    for test in [path for path in tests if path.is_file()][:1]:
        held, about = transforms.shots(test, transforms.load(test))
        has_photographs = any(map(is_file, transforms.images(root, held)))
        if has_photographs or not any(map(is_file, transforms.images(root, shots))):
            shots += [replace(shot, split="test") for shot in held]
            findings += about
        else:
            message = f"{test.name} holds {len(held)} cameras without photographs; it is left out"
            findings.append(note("poses-only", message))
    images = transforms.images(root, shots)
    return frame_set(path, FORMAT, shots, images=images, findings=findings)
