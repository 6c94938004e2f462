# SPDX-License-Identifier: Apache-2.0
"""Rigs and frames of COLMAP 4: where a camera is in its rig, and where the rig was.

They are what COLMAP itself reads; the poses in its images file are only written beside them
(src/colmap/scene/reconstruction_io_binary.cc and _text.cc).
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator

import numpy as np

from robir.capture.frames import Array
from robir.capture.readers.shots import opencv_view, turned_by

Take = Callable[[str], tuple]  # next values of a file, by their codes in `struct`
_CAMERA = 0
_SENSORS = {"INVALID": "-1", "CAMERA": "0", "IMU": "1"}
_POSE = "7d"


def poses(rigs: bytes, frames: bytes, is_text: bool) -> dict[int, Array]:
    """Camera-to-world of images by number, OpenGL axes; only of cameras whose place is known."""
    places: dict[tuple[int, int, int], Array] = {}
    for take in _entries(rigs, is_text):
        rig, count = take("II")
        if count:
            places[(rig, *take("iI"))] = np.eye(4)
        for _ in range(count - 1):
            sensor, (has_pose,) = take("iI"), take("B")
            if has_pose:
                places[(rig, *sensor)] = _matrix(take(_POSE))
    found = {}
    for take in _entries(frames, is_text):
        (_, rig), world = take("II"), _matrix(take(_POSE))
        for _ in range(take("I")[0]):
            kind, sensor, image = take("iIQ")
            if kind == _CAMERA and (rig, kind, sensor) in places:
                with np.errstate(all="ignore"):
                    view = places[rig, kind, sensor] @ world
                found[image] = opencv_view(view[:3, :3], view[:3, 3])
    return found


def _matrix(numbers: tuple[float, ...]) -> Array:
    result = np.eye(4)
    result[:3, :3], result[:3, 3] = turned_by(numbers[:4]), numbers[4:]
    return result


def _entries(content: bytes, is_text: bool) -> Iterator[Take]:
    """What takes the values of each entry, one after the other."""
    if is_text:
        for line in content.decode("utf-8").splitlines():
            words = iter(line.split())
            if line.strip() and not line.startswith("#"):
                yield lambda codes, words=words: tuple(_word(words, c) for c in _codes(codes))
        return
    at = 8

    def take(codes: str) -> tuple:
        nonlocal at
        values = struct.unpack_from(f"<{codes}", content, at)
        at += struct.calcsize(f"<{codes}")
        return values

    for _ in range(struct.unpack_from("<Q", content)[0]):
        yield take


def _codes(codes: str) -> str:
    return "d" * 7 if codes == _POSE else codes


def _word(words: Iterator[str], code: str) -> float | int:
    word = next(words, "")
    return float(word) if code == "d" else int(_SENSORS.get(word, word))
