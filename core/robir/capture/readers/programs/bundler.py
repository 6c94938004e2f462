# SPDX-License-Identifier: Apache-2.0
"""Bundler: bundle.out with the list of photographs.

A camera is its focal length in pixels, k1, k2, the rotation row by row and the translation from
world to camera. Cameras look along their -z with y up, which is our own convention; image points
count from the middle of the picture (Bundler user's manual, "Output format"). A focal length of 0
is a photograph that was not placed. Photographs stand in list.txt, line by line in this order.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
from msgspec import Meta

from robir.capture.frames import Array, Distortion, FrameSet, Lens
from robir.capture.readers.files import head, read_text
from robir.capture.readers.shots import Shot, frame_set, sane_points
from robir.capture.readers.values import checked
from robir.capture.refusal import note, refuse

FORMAT = "bundler"

_CURE = "Export it as Bundler again, with its list of photographs."
_Counts = Annotated[list[Annotated[int, Meta(ge=0, le=10**7)]], Meta(min_length=2, max_length=2)]
_Row = Annotated[list[float], Meta(min_length=15, max_length=15)]


def looks_like(path: Path) -> bool:
    """Whether a file begins as Bundler's do."""
    return head(path, 64).lstrip().lower().startswith("# bundle file")


def read(path: Path) -> FrameSet:
    """Read placed cameras and sparse points."""
    names = _names(path)
    try:
        lines = [line for line in read_text(path).splitlines() if line.strip()[:1] not in ("#", "")]
    except (OSError, ValueError) as fault:
        raise refuse("bad-bundle", f"{path} is unreadable ({fault})", _CURE, path.name) from None
    first = lines[0].split() if lines else []
    cameras, points = checked(path, first, _Counts, _CURE, where="the counts", is_text=True)
    if cameras > len(names) or len(lines) < 1 + 5 * cameras:
        message = f"{path} states {cameras} cameras, but holds {len(lines) - 1} lines and "
        message += f"{len(names)} photographs are listed"
        raise refuse("bad-bundle", message, _CURE, path.name)
    shots, lost = [], []
    for index, name in enumerate(names[:cameras]):
        words = " ".join(lines[1 + 5 * index : 6 + 5 * index]).split()
        row: Array = np.array(checked(path, words, _Row, _CURE, where=name[:80], is_text=True))
        focal, k1, k2 = row[:3].tolist()
        if focal == 0:
            lost.append(name)
            continue
        pose = np.eye(4)
        with np.errstate(all="ignore"):
            pose[:3, :3] = row[3:12].reshape(3, 3).T
            pose[:3, 3] = -pose[:3, :3] @ row[12:]
        lens = Lens(fx=focal, distortion=Distortion(radial=(k1, k2, 0.0, 0.0)))
        shots.append(Shot(name=name, lens=lens, pose=pose))
    findings = []
    if lost and shots:
        message = f"{len(lost)} of {cameras} photographs of {path.name} were not placed"
        findings.append(note("unposed-views", message, *lost))
    rows = lines[1 + 5 * cameras :: 3][:points]
    cloud = sane_points([row.split()[:3] for row in rows])
    return frame_set(path, FORMAT, shots, points=cloud, findings=findings)


def _names(path: Path) -> list[str]:
    """The listed photographs; other programs name the list after the file of cameras."""
    own = path.with_name(path.name.replace("bundle.out", "list.txt"))
    places = [own, path.with_name("list.txt"), path.parent.parent / "list.txt"]
    listed = next((place for place in places if place != path and place.is_file()), None)
    if listed is None:
        message = f"{path} names no photographs, and there is no list.txt beside it"
        cure = "Put the list of photographs that it was made from beside it, as list.txt."
        raise refuse("missing-list", message, cure, path.name)
    try:
        lines = read_text(listed).splitlines()
    except (OSError, ValueError) as fault:
        raise refuse("bad-bundle", f"{listed} is unreadable ({fault})", _CURE, path.name) from None
    # a name may be followed by 0 and the focal length from EXIF
    return [_without_focal(line) for line in lines if line.strip()]


def _without_focal(line: str) -> str:
    words = line.rsplit(maxsplit=2)
    return words[0] if len(words) == 3 and words[1] == "0" else line.strip()
