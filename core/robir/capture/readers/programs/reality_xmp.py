# SPDX-License-Identifier: Apache-2.0
"""RealityScan (RealityCapture): an XMP file beside each photograph.

Rotation is that from world to camera with OpenCV axes, row by row, Position the centre.
FocalLength35mm is for a frame 36 wide, the principal point an offset in lengths of the longer side
(Epic, "RealityCapture XMP Camera Math"). The coefficients are k1 to k4, t1 and t2; t1 is OpenCV's
p2 and t2 its p1 (AliceVision, main_importKnownPoses.cpp, swaps them).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from robir.capture.frames import IMAGE_SUFFIXES, Distortion, FrameSet
from robir.capture.readers.files import IMAGE_FOLDERS, children, head, load_xml
from robir.capture.readers.reality_scan import film_lens
from robir.capture.readers.shots import Shot, frame_set, opencv_pose
from robir.capture.readers.values import Number, checked
from robir.capture.refusal import note, refuse

FORMAT = "realityscan-xmp"

_CURE = "Export the metadata (XMP) from RealityScan again, camera poses included."
_MODELS = ("perspective", "brown3", "brown4", "brown3t2", "brown4t2")


def looks_like(path: Path) -> bool:
    """Whether a file is a camera with a pose."""
    start = head(path)
    return "capturingreality.com" in start and "Rotation" in start and "Position" in start


def find(source: Path) -> Path | None:
    """The folder of photographs with such files, the source itself or in it."""
    for folder in (source, *(source / name for name in IMAGE_FOLDERS[:-1])):
        files = [path for path in children(folder) if path.suffix.lower() == ".xmp"]
        if any(looks_like(path) for path in files[:5]):
            return folder
    return None


def read(folder: Path) -> FrameSet:
    """Read poses and intrinsics."""
    files = [path for path in children(folder) if path.suffix.lower() == ".xmp"]
    pictures = {
        path.stem: path for path in children(folder) if path.suffix.lower() in IMAGE_SUFFIXES
    }
    posed = [path for path in files if path.stem in pictures and looks_like(path)]
    shots = [_shot(path, pictures[path.stem]) for path in posed]
    images = [pictures[path.stem] for path in posed]
    unused = [path.name for path in files if path not in posed]
    findings = []
    if unused and shots:
        message = f"{len(unused)} XMP files have no pose or no photograph"
        findings.append(note("unused-cameras", message, *unused))
    return frame_set(folder.with_name("*.xmp"), FORMAT, shots, images=images, findings=findings)


def _shot(path: Path, photograph: Path) -> Shot:
    entries: dict[str, str] = {}
    for element in load_xml(path, _CURE).iter():
        entries |= {key.rpartition("}")[2]: value for key, value in element.attrib.items()}
        entries[element.tag.rpartition("}")[2]] = element.text or ""

    def numbers(key: str, count: int, default: str = "") -> list[float]:
        values = checked(
            path, entries.get(key, default).split(), list[Number], _CURE, where=key, is_text=True
        )
        if len(values) < count:
            fault = f"{path}: {key} holds {len(values)} of {count} numbers"
            raise refuse("bad-xml", fault, _CURE, path.name)
        return values

    model = entries.get("DistortionModel", "perspective")
    is_square = numbers("Skew", 1, "0")[0] == 0 and numbers("AspectRatio", 1, "1")[0] == 1
    if model not in _MODELS or not is_square:
        raise refuse(
            "camera-model",
            f"{path}: the camera model {model} is not supported, or its pixels are not square",
            'Set the distortion model to "Brown3" in RealityScan, align and export again.',
            path.name,
        )
    k1, k2, k3, k4, t1, t2 = (*numbers("DistortionCoeficients", 0), *[0.0] * 6)[:6]
    if not model.endswith("t2"):
        t1 = t2 = 0.0
    middle = (numbers("PrincipalPointU", 1, "0")[0], numbers("PrincipalPointV", 1, "0")[0])
    bent = Distortion(radial=(k1, k2, k3, k4), tangential=(t2, t1))
    turn = np.array(numbers("Rotation", 9)[:9]).reshape(3, 3)
    return Shot(
        name=f"{photograph.parent.name}/{photograph.name}",
        lens=film_lens(photograph, numbers("FocalLength35mm", 1)[0], middle, bent),
        pose=opencv_pose(turn.T, np.array(numbers("Position", 3)[:3])),
    )
