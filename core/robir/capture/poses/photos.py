# SPDX-License-Identifier: Apache-2.0
"""Which files of a folder are the photographs, and what their EXIF data says about the lens."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from PIL import ExifTags

from robir.capture.capture import Finding
from robir.capture.frames import IMAGE_SUFFIXES
from robir.capture.masks.given import IGNORE, natural_order
from robir.capture.readers.files import children, is_other, without_others
from robir.capture.refusal import note, refuse
from robir.jobs.names import UnsafeNameError, checked_name

# kinds of videos that frames are taken from
VIDEO_SUFFIXES = (".mp4", ".mov", ".m4v", ".mkv", ".webm", ".avi", ".3gp")
_PHOTO_FOLDERS = ("images", "image", "photos", "photographs", "input", "rgb")

_RENAME = "Rename it with letters and digits, or take it away."

# millimetres; what a "35 mm equivalent" focal length refers to
_SMALL_FORMAT_DIAGONAL = math.hypot(36.0, 24.0)
_MILLIMETRES = {2: 25.4, 3: 10.0, 4: 1.0}  # millimetres in a unit of EXIF's focal plane resolution


@dataclass(frozen=True, slots=True, kw_only=True)
class Lens:
    """What EXIF data says about how a photograph was taken.

    Attributes:
        body: Maker and model of the camera, empty if not stated.
        setting: Focal lengths as stated; photographs of one setting share their intrinsics.
        focal: Focal length in widths of the longer side, or None.
    """

    body: str = ""
    setting: tuple[float, ...] = ()
    focal: float | None = None


def find_photographs(source: Path) -> list[Path]:
    """Photographs of a folder in natural order; empty if there are none.

    Those in the folder itself count; without any, those in its folder of photographs, or, if it
    has none of a usual name, in all its folders that do not hold masks.

    Args:
        source: Folder.
    """
    own = _photographs_in(source)
    if own:
        return own
    folders = [path for path in children(source) if path.is_dir()]
    folders = [path for path in folders if not path.name.startswith(".")]
    usual = [path for path in folders if path.name.lower() in _PHOTO_FOLDERS]
    usual = usual or [path for path in folders if not is_other(path)]
    return [photo for folder in usual for photo in _photographs_in(folder)]


def stray_files(source: Path, photographs: Iterable[Path]) -> list[Finding]:
    """A note that names what lies among the photographs and is none.

    Args:
        source: Folder of the capture.
        photographs: What `find_photographs` found in it.
    """
    used = set(photographs)
    folders = {source, *(path.parent for path in used)}
    strays = [
        path.relative_to(source).as_posix()
        for folder in sorted(folders)
        for path in children(folder)
        if path.is_file() and path not in used and not path.name.startswith(".")
    ]
    if not strays:
        return []
    message = f"{len(strays)} files among the photographs are no photographs and are ignored"
    return [note("stray-files", message, *strays)]


def lens_of(exif: dict[int, object], size: tuple[int, int]) -> Lens:
    """The lens as EXIF data states it.

    Args:
        exif: Tags, as from `robir.capture.images.decode.exif_values`.
        size: Width and height of the photograph as stored, pixels.
    """
    tag = ExifTags.Base
    focal_35 = _number(exif.get(tag.FocalLengthIn35mmFilm))
    focal_mm = _number(exif.get(tag.FocalLength))
    body = " ".join(str(exif[key]).strip("\0 ") for key in (tag.Make, tag.Model) if exif.get(key))
    focal = None
    if focal_35:
        focal = focal_35 / _SMALL_FORMAT_DIAGONAL * math.hypot(*size) / max(size)
    elif focal_mm:
        unit = _MILLIMETRES.get(int(_number(exif.get(tag.FocalPlaneResolutionUnit)) or 2), 25.4)
        density = _number(exif.get(tag.FocalPlaneXResolution))
        sensor = max(_number(exif.get(tag.ExifImageWidth)), _number(exif.get(tag.ExifImageHeight)))
        focal = focal_mm * density / unit / (sensor or max(size)) if density else None
    if focal is not None and not 0.2 < focal < 20:
        focal = None
    setting = tuple(value for value in (focal_mm, focal_35) if value)
    return Lens(body=body, setting=setting, focal=focal)


def _photographs_in(folder: Path) -> list[Path]:
    found = [
        path
        for path in children(folder)
        if path.suffix.lower() in IMAGE_SUFFIXES
        and path.is_file()
        and not path.name.startswith((".", IGNORE))
    ]
    for path in found:
        try:
            checked_name(path.name)
        except UnsafeNameError as fault:
            raise refuse(
                "bad-name", f"A file in {folder} cannot be named: {fault}", _RENAME
            ) from None
    return sorted(without_others(found), key=lambda path: natural_order(path.name))


def _number(value: object) -> float:
    """A positive number of EXIF data, or 0."""
    try:
        number = float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError, ZeroDivisionError):
        return 0.0
    return number if 0 < number < 1e6 else 0.0
