# SPDX-License-Identifier: Apache-2.0
"""RealityScan (RealityCapture): the CSV export "Internal/External camera parameters".

A row is a photograph: name,x,y,alt,heading,pitch,roll,f,px,py,k1,k2,k3,k4,t1,t2. The position is
the camera's in the export's coordinate system, z up. Angles are degrees; all zero is a camera that
looks straight down with y at the top of its picture, and camera-to-world with OpenGL axes is

    Rz(-heading) Rx(pitch) Ry(roll)

(nerfstudio, realitycapture_utils.py; it reproduces to 1e-4 the matrix that RealityCapture wrote as
XMP beside a CSV row, Epic forum topic 710449). f is the focal length for a frame 36 wide, px and py
the principal point's offset from the middle in lengths of the longer side: pixels are f L / 36 and
px L with L = max(width, height) (Epic, "RealityCapture XMP Camera Math": "coordinates x and y
are always in range -0.5, 0.5", FocalLength35mm, PrincipalPointU). k and t are Brown's polynomial
and tangential part at focal length one, t1 being OpenCV's p2 and t2 its p1 (AliceVision,
main_importKnownPoses.cpp, swaps them).

Beside each photograph there may be an XMP file instead: Rotation is that from world to camera with
OpenCV axes, row by row, Position the centre, FocalLength35mm and the rest as above; coefficients
are k1 to k4, t1 and t2.

The CSV file names neither the image size, which is taken from the photographs as stored, nor the
distortion model: the export must have been made with a Brown model, as it is by default.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from scipy.spatial.transform import Rotation

from robir.capture.frames import Array, Distortion, FrameSet, Lens
from robir.capture.images.decode import stored_size
from robir.capture.readers.files import (
    IMAGE_FOLDERS,
    Number,
    checked,
    children,
    head,
    load_table,
    load_xml,
    locate_photographs,
    pictures_in,
)
from robir.capture.readers.shots import Shot, frame_set, opencv_pose, opengl_pose
from robir.capture.refusal import refuse, some

_SIGNATURE = frozenset({"name", "heading", "pitch", "roll"})
_MAX_COLUMNS = 1000
_POSE = ("x", "y", "alt", "heading", "pitch", "roll", "f")
_FILM = 36.0
_CURE = 'Export "Internal/External camera parameters" (CSV) again.'
_XMP_CURE = "Export the metadata (XMP) from RealityScan again, camera poses included."
_MODELS = ("perspective", "brown3", "brown4", "brown3t2", "brown4t2")


def looks_like(path: Path) -> bool:
    """Whether a file is a table of names and headings."""
    return _header([line.split(",") for line in head(path).splitlines()[:3]]) is not None


def read(path: Path) -> FrameSet:
    """Read poses and intrinsics, in the coordinate system of the export."""
    rows = _rows(path)
    root, relatives = locate_photographs(path, [row["name"] for row in rows])
    places = [root / relative for relative in relatives]
    shots = [_shot(path, row, place) for row, place in zip(rows, places, strict=True)]
    return frame_set(path, "realityscan", shots)


def _columns(words: list[str]) -> list[str]:
    return [word.strip().lstrip("#").strip().lower() for word in words]


def _header(rows: list[list[str]]) -> int | None:
    """Which of the first rows names the columns; a count of the cameras may come before."""
    found = (i for i, row in enumerate(rows[:3]) if set(_columns(row)) >= _SIGNATURE)
    return next(found, None)


def _rows(path: Path) -> list[dict[str, str]]:
    table = load_table(path, _CURE)
    start = _header(table) or 0
    columns = _columns(table[start]) if table else []
    absent = [column for column in _POSE if column not in columns]
    if absent:
        raise refuse("missing-key", f"{path} has no column {', '.join(absent)}", _CURE, path.name)
    rows = table[start + 1 :]
    short = next((i for i, row in enumerate(rows, start=1) if len(row) < len(columns)), None)
    if short is not None or len(columns) > _MAX_COLUMNS:
        fault = f"row {short} has {len(rows[short - 1])} of " if short else "its header has "
        raise refuse("bad-table", f"{path}: {fault}{len(columns)} values", _CURE, path.name)
    return [dict(zip(columns, row, strict=False)) for row in rows]


_NEEDED = [(key, float) for key in _POSE]
_LENS = [(key, float, 0.0) for key in ("px", "py", "k1", "k2", "k3", "k4", "t1", "t2")]
_Row = msgspec.defstruct("_Row", [*_NEEDED, *_LENS])  # the numbers of a photograph


def _shot(path: Path, texts: dict[str, str], photograph: Path) -> Shot:
    where = f"the row of {texts['name'][:80]}"
    row: Any = checked(path, texts, _Row, _CURE, where=where, code="bad-table", is_text=True)
    turn = rotation(row.heading, row.pitch, row.roll)
    bent = Distortion(radial=(row.k1, row.k2, row.k3, row.k4), tangential=(row.t2, row.t1))
    lens = _film_lens(photograph, row.f, (row.px, row.py), bent)
    return Shot(name=texts["name"], lens=lens, pose=opengl_pose(turn, (row.x, row.y, row.alt)))


def rotation(heading: float, pitch: float, roll: float) -> Array:
    """Camera-to-world rotation with OpenGL axes from angles in degrees, (3, 3)."""
    angles = np.array([-heading, pitch, roll])
    if not np.isfinite(angles).all():
        return np.full((3, 3), np.nan)
    return Rotation.from_euler("ZXY", angles, degrees=True).as_matrix()


def _film_lens(
    photograph: Path, focal: float, middle: tuple[float, float], distortion: Distortion
) -> Lens:
    """Intrinsics in pixels of focal length on a frame 36 wide and offset in longer sides."""
    size = stored_size(photograph) if photograph.is_file() else None
    if size is None:
        return Lens(angle_x=1.0)
    (width, height), longer = size, max(size)
    cx, cy = 0.5 * width + middle[0] * longer, 0.5 * height + middle[1] * longer
    fx = focal * longer / _FILM
    return Lens(width=width, height=height, fx=fx, cx=cx, cy=cy, distortion=distortion)


def is_sidecar(path: Path) -> bool:
    """Whether a file is a camera with a pose."""
    start = head(path)
    return "capturingreality.com" in start and "Rotation" in start and "Position" in start


def find_sidecars(source: Path) -> Path | None:
    """The folder of photographs with such files, the source itself or in it."""
    for folder in (source, *(source / name for name in IMAGE_FOLDERS[:-1])):
        files = [path for path in children(folder) if path.suffix.lower() == ".xmp"]
        if any(is_sidecar(path) for path in files[:5]):
            return folder
    return None


def read_sidecars(folder: Path) -> FrameSet:
    """Read poses and intrinsics."""
    files = [path for path in children(folder) if path.suffix.lower() == ".xmp"]
    pictures = {path.stem: path for path in pictures_in(folder)}
    posed = [path for path in files if path.stem in pictures and is_sidecar(path)]
    shots = [_sidecar_shot(path, pictures[path.stem]) for path in posed]
    unused = [path.name for path in files if path not in posed]
    message = f"{len(unused)} XMP files have no pose or no photograph"
    findings = some("note", "unused-cameras", unused, message)
    return frame_set(folder.with_name("*.xmp"), "realityscan-xmp", shots, findings)


def _sidecar_shot(path: Path, photograph: Path) -> Shot:
    entries: dict[str, str] = {}
    for element in load_xml(path, _XMP_CURE).iter():
        entries |= {key.rpartition("}")[2]: value for key, value in element.attrib.items()}
        entries[element.tag.rpartition("}")[2]] = element.text or ""

    def numbers(key: str, count: int, default: str = "") -> list[float]:
        words, kind = entries.get(key, default).split(), list[Number]
        values = checked(path, words, kind, _XMP_CURE, where=key, is_text=True)
        if len(values) < count:
            fault = f"{path}: {key} holds {len(values)} of {count} numbers"
            raise refuse("bad-xml", fault, _XMP_CURE, path.name)
        return values

    model = entries.get("DistortionModel", "perspective")
    is_square = numbers("Skew", 1, "0")[0] == 0 and numbers("AspectRatio", 1, "1")[0] == 1
    if model not in _MODELS or not is_square:
        message = f"{path}: the camera model {model} is not supported, or its pixels are not square"
        cure = 'Set the distortion model to "Brown3" in RealityScan, align and export again.'
        raise refuse("camera-model", message, cure, path.name)
    k1, k2, k3, k4, t1, t2 = (*numbers("DistortionCoeficients", 0), *[0.0] * 6)[:6]
    if not model.endswith("t2"):
        t1 = t2 = 0.0
    middle = (numbers("PrincipalPointU", 1, "0")[0], numbers("PrincipalPointV", 1, "0")[0])
    bent = Distortion(radial=(k1, k2, k3, k4), tangential=(t2, t1))
    turn = np.array(numbers("Rotation", 9)[:9]).reshape(3, 3)
    return Shot(
        name=f"{photograph.parent.name}/{photograph.name}",
        image=photograph,
        lens=_film_lens(photograph, numbers("FocalLength35mm", 1)[0], middle, bent),
        pose=opencv_pose(turn.T, np.array(numbers("Position", 3)[:3])),
    )
