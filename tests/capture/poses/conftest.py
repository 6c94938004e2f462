# SPDX-License-Identifier: Apache-2.0
"""Photographs of the boulder, taken once, and what pycolmap makes of them."""

from __future__ import annotations

import pytest
from capture.poses.room import COUNT, Registered, Walk, photograph, ring
from PIL import Image

from robir.capture.poses.register import register


@pytest.fixture(scope="session")
def walk(tmp_path_factory: pytest.TempPathFactory) -> Walk:
    """Once around the boulder."""
    folder = tmp_path_factory.mktemp("walk")
    cameras = ring(COUNT)
    shots = [photograph(camera) for camera in cameras]
    (folder / "masks").mkdir()
    for i, (picture, mask) in enumerate(shots):
        Image.fromarray(picture).save(folder / f"p{i:02d}.png")
        Image.fromarray(mask).save(folder / "masks" / f"p{i:02d}.png")
    (folder / "notes.docx").write_bytes(b"not a photograph")
    (folder / "p99.jpg").write_bytes(b"\xff\xd8\xff\xe0 torn")
    return Walk(folder, cameras, [shot[0] for shot in shots], [shot[1] for shot in shots])


@pytest.fixture(scope="session")
def registered(walk: Walk, tmp_path_factory: pytest.TempPathFactory) -> Registered:
    """The walk's cameras as found."""
    work = tmp_path_factory.mktemp("work") / "registration"
    messages: list[str] = []
    frames = register(walk.folder, work, 0, lambda share, text: messages.append(text))
    return Registered(frames, messages, work)
