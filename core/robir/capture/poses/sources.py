# SPDX-License-Identifier: Apache-2.0
"""What poses are found from: the photographs of a folder, what EXIF says of their lenses, videos.

Of a video the sharpest frame of each of a hundred equal spans of time is taken.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import ExifTags, Image
from scipy import ndimage

from robir.capture.capture import Finding
from robir.capture.frames import IMAGE_SUFFIXES
from robir.capture.images.decode import INSTALL_PHOTOS
from robir.capture.masks.given import IGNORE, natural_order
from robir.capture.readers.files import children, is_other, without_others
from robir.capture.refusal import CaptureRefusedError, note, refuse, some
from robir.capture.views import Progress
from robir.jobs.names import UnsafeNameError, checked_name, regular
from robir.jobs.paths import replacing

FRAMES = 100  # frames taken from a video at most
MAX_BYTES = 1 << 35  # largest video
_SHARPNESS_SIDE = 480  # longer side, pixels, that sharpness is measured at: noise must not count
_MAX_FRAME_PIXELS = 36_000_000  # a little more than 8K: decoders keep up to sixteen frames
_CONTAINERS: dict[str, str] = {
    **dict.fromkeys((".mp4", ".mov", ".m4v", ".3gp"), "mov"),
    **dict.fromkeys((".mkv", ".webm"), "matroska"),
    ".avi": "avi",
}
_PHOTO_FOLDERS = ("images", "image", "photos", "photographs", "input", "rgb")
_SMALL_FORMAT_DIAGONAL = math.hypot(36.0, 24.0)  # millimetres, of "35 mm equivalent"
_MILLIMETRES = {2: 25.4, 3: 10.0, 4: 1.0}  # in a unit of EXIF's focal plane resolution


@dataclass(frozen=True, slots=True, kw_only=True)
class StatedLens:
    """What EXIF data says about how a photograph was taken."""

    body: str = ""  # maker and model of the camera, empty if not stated
    setting: tuple[float, ...] = ()  # focal lengths as stated; one setting has one lens
    focal: float | None = None  # focal length in widths of the longer side, or None


def is_video(source: Path) -> bool:
    """Whether a path is a video file."""
    return source.is_file() and source.suffix.lower() in _CONTAINERS


def find_photographs(source: Path) -> list[Path]:
    """Photographs of a folder in natural order, else of its usual folders, else of all in it."""
    own = _photographs_in(source)
    if own:
        return own
    folders = [p for p in children(source) if p.is_dir() and not p.name.startswith(".")]
    usual = [path for path in folders if path.name.lower() in _PHOTO_FOLDERS]
    usual = usual or [path for path in folders if not is_other(path)]
    return [photo for folder in usual for photo in _photographs_in(folder)]


def _photographs_in(folder: Path) -> list[Path]:
    pictures = [path for path in children(folder) if path.suffix.lower() in IMAGE_SUFFIXES]
    found = [p for p in pictures if p.is_file() and not p.name.startswith((".", IGNORE))]
    for path in found:
        try:
            checked_name(path.name)
        except UnsafeNameError as fault:
            message = f"A file in {folder} cannot be named: {fault}"
            cure = "Rename it with letters and digits, or take it away."
            raise refuse("bad-name", message, cure) from None
    return sorted(without_others(found), key=lambda path: natural_order(path.name))


def stray_files(source: Path, photographs: Iterable[Path]) -> list[Finding]:
    """A note that names what lies among the photographs found in a folder and is none."""
    used = set(photographs)
    strays = [
        path.relative_to(source).as_posix()
        for folder in sorted({source, *(path.parent for path in used)})
        for path in children(folder)
        if path.is_file() and path not in used and not path.name.startswith(".")
    ]
    message = f"{len(strays)} files among the photographs are no photographs and are ignored"
    return some("note", "stray-files", strays, message)


def lens_of(exif: dict[int, object], size: tuple[int, int]) -> StatedLens:
    """The lens as EXIF tags state it, for a photograph stored with so many pixels."""
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
    return StatedLens(body=body, setting=setting, focal=focal)


def _number(value: object) -> float:
    """A positive number of EXIF data, or 0."""
    try:
        number = float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError, ZeroDivisionError):
        return 0.0
    return number if 0 < number < 1e6 else 0.0


def take_frames(video: Path, folder: Path, progress: Progress) -> list[Finding]:
    """Write the sharpest frames of a video as frame_NUMBER.png, upright; a note on them."""

    def bad(what: str) -> CaptureRefusedError:
        cure = "Save it as MP4 (H.264), or give its frames as photographs."
        return refuse("bad-video", f"{video} {what}", cure, video.name)

    try:
        import av
        from av.error import FFmpegError
    except ImportError:
        message = f"{video} is a video, which needs the package av"
        cure = f"{INSTALL_PHOTOS}; or give its frames as photographs."
        raise refuse("missing-reader", message, cure, video.name) from None
    folder.mkdir(parents=True, exist_ok=True)
    taken = 0
    try:
        kind = _CONTAINERS[video.suffix.lower()]  # alone: content may name other files
        container: Any
        with regular(video, MAX_BYTES) as file, av.open(file, format=kind) as container:
            if not container.streams.video:
                raise bad("holds no pictures")
            codec = container.streams.video[0].codec_context
            if codec is None:
                raise bad("is encoded in a way that the package av does not know")
            if codec.width * codec.height > _MAX_FRAME_PIXELS:
                raise bad("has huge frames")
            # of every frame: later ones may be larger than the first
            codec.options = {"max_pixels": str(_MAX_FRAME_PIXELS)}
            # frames it has, whatever its header claims; none is decoded for that
            total = max(1, sum(packet.size > 0 for packet in container.demux(video=0)))
            container.seek(0)
            for number, frame in _sharpest(container, total, progress):
                taken += 1
                _write(frame, folder / f"frame_{number:06d}.png")
    except (FFmpegError, OSError, ValueError) as fault:
        raise bad(f"is damaged or cannot be decoded ({fault})") from None
    message = f"{taken} frames of {video.name} were taken, the sharpest of each span of time"
    return [note("video-frames", message)]


def sharpness(grey: NDArray[np.uint8]) -> float:
    """Variance of a picture's (H, W) Laplacian over its own: falls with blur, not with contrast."""
    values = grey.astype(np.float32)
    return float(ndimage.laplace(values).var() / (values.var() + 1.0))


def _sharpest(container: Any, total: int, progress: Progress) -> Iterator[tuple[int, Any]]:
    """Number and picture of the sharpest frame of each span, in order."""
    span = max(1.0, total / FRAMES)
    best: tuple[float, int, Any] | None = None
    current = 0
    for number, frame in enumerate(container.decode(video=0)):
        if int(number / span) != current and best is not None:
            yield best[1:]
            best, current = None, int(number / span)
        score = sharpness(_grey(frame))
        if best is None or score > best[0]:
            best = (score, number, frame)
        if number % 10 == 0:
            progress(min(1.0, number / total), f"frame {number} of {total}")
    if best is not None:
        yield best[1:]


def _grey(frame: Any) -> NDArray[np.uint8]:
    scale = min(1.0, _SHARPNESS_SIDE / max(frame.width, frame.height))
    # Even sizes: codecs and their converters know no other.
    width, height = (2 * max(1, round(side * scale / 2)) for side in (frame.width, frame.height))
    return frame.reformat(width=width, height=height, format="gray").to_ndarray()


def _write(frame: Any, path: Path) -> None:
    picture = Image.fromarray(frame.to_ndarray(format="rgb24"))
    # Phones store pictures as the sensor lies and note how far to turn them, counter-clockwise.
    if frame.rotation % 360:
        picture = picture.rotate(frame.rotation, expand=True)
    with replacing(path) as temporary:
        picture.save(temporary, format="PNG", compress_level=1)
