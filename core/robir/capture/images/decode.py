# SPDX-License-Identifier: Apache-2.0
"""The one door for photographs and masks: which files are opened, how large, and by what.

A file counts only if it is a regular one and holds one of a few formats by content: PNG,
JPEG, TIFF, BMP, WebP, or, under its own suffix, EXR, HEIC or RAW; optional packages decode the
last two. Its size is looked at before a pixel is decoded. Nothing else of Pillow's is ever asked,
for it knows formats that start other programs.

Where a package is missing, the refusal says how to install it. EXIF data never stops a photograph:
what is damaged there counts as absent.
"""

from __future__ import annotations

import struct
import warnings
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray
from PIL import ExifTags, Image, UnidentifiedImageError

from robir.capture.frames import HEIF_SUFFIXES, LINEAR_SUFFIXES, RAW_SUFFIXES
from robir.capture.images.linear import is_floating_tiff, read_linear
from robir.capture.images.opencv import cv2
from robir.capture.images.pixels import code_points
from robir.capture.refusal import CaptureRefusedError, refuse
from robir.jobs.names import read_regular, regular

# the cure for a missing optional package, in one place
INSTALL_PHOTOS = "Install what reads it with: pip install 'robir[photos]'"
MAX_PIXELS = 100_000_000  # largest photograph: decoding takes up to sixteen bytes a pixel
_MAX_SIDE = 65_535  # of a JPEG; other formats allow pictures that are a billion wide and one high
MAX_FILE_BYTES = 1 << 30  # largest file of a photograph
_MAX_DECODED = 2_000_000_000  # pixels that a JPEG's scans, each over all of them, may go over
MAX_EXIF_BYTES = 1 << 20  # largest EXIF data that is looked at; JPEG can have a sixteenth of it
DEVELOPED = "developed"  # in a picture's `info`: developed here, without a tone curve
_WHOLE = "whole"  # in a picture's `info`: its size before `reduce`
_FORMATS = ("PNG", "JPEG", "TIFF", "BMP", "WEBP")
SCAN = b"\xff\xda"

# what Pillow raises for broken files
_DAMAGE = (OSError, SyntaxError, ValueError, EOFError, Image.DecompressionBombError, MemoryError)
# what Pillow raises for broken EXIF data
_BAD_EXIF = (*_DAMAGE, TypeError, KeyError, IndexError, AttributeError, struct.error)
# what brings a photograph of each EXIF orientation upright
_T = Image.Transpose
_TURNS = {2: _T.FLIP_LEFT_RIGHT, 3: _T.ROTATE_180, 4: _T.FLIP_TOP_BOTTOM, 5: _T.TRANSPOSE}
_TURNS |= {6: _T.ROTATE_270, 7: _T.TRANSVERSE, 8: _T.ROTATE_90}


@contextmanager
def opened(path: Path) -> Iterator[Image.Image]:
    """A picture file of `IMAGE_SUFFIXES`, decoded, as stored, RAW upright; or `CaptureError`."""
    with header(path) as picture:
        load(picture, path)
        yield picture


def load(picture: Image.Image, path: Path) -> None:
    """Decode the pixels of an open picture."""
    if picture.format in ("JPEG", "MPO"):
        scans = read_regular(path, MAX_FILE_BYTES).count(SCAN)
        _refuse_large(path, picture.info[_WHOLE], scans)
    try:
        picture.load()
    except _DAMAGE as fault:
        raise _damaged(path, fault) from None


def deep_codes(picture: Image.Image, path: Path) -> NDArray[np.uint16] | None:
    """Codes (H, W, 3 or 4) of a picture of 16 bits a channel; None for others and turned TIFFs."""
    tiles = getattr(picture, "tile", ())
    is_deep = picture.mode in ("RGB", "RGBA") and any(";16" in str(tile[3]) for tile in tiles)
    if not is_deep or (picture.format == "TIFF" and orientation(picture) != 1):
        return None
    content = np.frombuffer(read_regular(path, MAX_FILE_BYTES), np.uint8)
    codes = cv2.imdecode(content, cv2.IMREAD_UNCHANGED)
    if codes is None or codes.dtype != np.uint16 or codes.ndim != 3:
        return None
    return codes[:, :, [2, 1, 0, 3][: codes.shape[2]]] if codes.shape[2] in (3, 4) else None


def reduce(picture: Image.Image, factor: int) -> int:
    """Let an open JPEG be decoded at a fraction 1, 2, 4 or 8 of its size; the reduction applied."""
    width, height = picture.size
    if factor > 1 and picture.format == "JPEG":
        picture.draft(None, (max(1, width // factor), max(1, height // factor)))
    return round(width / picture.size[0])


def stored_size(path: Path) -> tuple[int, int] | None:
    """Width and height of a picture as `opened` yields it, or None if it cannot be opened."""
    try:
        with header(path) as picture:
            return picture.size
    except CaptureRefusedError:
        return None


def may_hold_alpha(path: Path) -> bool:
    """Whether a picture has transparency of any kind, without decoding it."""
    if path.suffix.lower() in (*RAW_SUFFIXES, *HEIF_SUFFIXES):
        return False
    try:
        with header(path) as picture:
            return picture.has_transparency_data
    except CaptureRefusedError:
        return False


@contextmanager
def header(path: Path) -> Iterator[Image.Image]:
    """A picture of a size that can be decoded, its pixels unread; or a `CaptureError`."""
    suffix = path.suffix.lower()
    formats = _FORMATS
    if suffix in HEIF_SUFFIXES:
        _register_heif(path)
        formats = (*_FORMATS, "HEIF")
    with ExitStack() as stack:
        # Damaged EXIF data and pictures of 50 to 100 megapixels are no reason to stop.
        stack.enter_context(warnings.catch_warnings())
        warnings.simplefilter("ignore")
        try:
            file = stack.enter_context(regular(path, MAX_FILE_BYTES))
            if suffix in RAW_SUFFIXES:
                picture = _developed(path, file)
            elif is_floating_tiff(file) or suffix in LINEAR_SUFFIXES:
                picture = read_linear(path, file, MAX_PIXELS // 4)
            else:
                picture = Image.open(file, formats=formats)
                if picture.format == "PNG":
                    picture.info |= code_points(file)
            picture.info[_WHOLE] = picture.size
            _refuse_large(path, picture.size)
        except FileNotFoundError:
            message = f"{path} does not exist"
            raise refuse("missing-images", message, "Put it there.", path.name) from None
        except PermissionError as fault:
            message, cure = f"{path} cannot be read ({fault.strerror})", "Give yourself the right."
            raise refuse("unreadable-images", message, cure, path.name) from None
        except UnidentifiedImageError:
            message = f"{path} is not a photograph that can be read"
            cure = "Save it as PNG, JPEG or TIFF."
            raise refuse("unreadable-images", message, cure, path.name) from None
        except _DAMAGE as fault:
            raise _damaged(path, fault) from None
        yield stack.enter_context(picture)


def excess(size: tuple[int, int], scans: int = 1) -> str | None:
    """What is too much of a picture, whose JPEG goes over its pixels `scans` times, or None."""
    pixels = size[0] * size[1]
    if pixels > MAX_PIXELS or max(size) > _MAX_SIDE:
        most = MAX_PIXELS // 1_000_000
        return f"is {size[0]}x{size[1]} pixels; pictures of up to {most} megapixels are read"
    if scans > 1 and scans * pixels > _MAX_DECODED:
        return f"stores its picture in {scans} passes, which takes too long to decode"
    return None


def _refuse_large(path: Path, size: tuple[int, int], scans: int = 1) -> None:
    if fault := excess(size, scans):
        raise refuse("too-large", f"{path} {fault}", "Save it smaller.", path.name)


def exif_values(picture: Image.Image) -> dict[int, object] | None:
    """EXIF tags of a picture, its sub-directory's too; None if nothing of its EXIF can be read."""
    if len(picture.info.get("exif") or b"") > MAX_EXIF_BYTES:
        return None
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            exif = picture.getexif()
            values = dict(exif) | dict(exif.get_ifd(ExifTags.IFD.Exif))
        except _BAD_EXIF:
            return None
    return values if values or not picture.info.get("exif") else None


def orientation(picture: Image.Image) -> int:
    """EXIF orientation, 1 to 8; 1, which is upright, where nothing sensible is stated."""
    value = (exif_values(picture) or {}).get(ExifTags.Base.Orientation, 1)
    return value if isinstance(value, int) and value in _TURNS else 1


def upright(picture: Image.Image, orientation: int) -> Image.Image:
    """The picture turned as an EXIF orientation says."""
    return picture.transpose(_TURNS[orientation]) if orientation in _TURNS else picture


def undone(orientation: int) -> int:
    """The EXIF orientation whose turn undoes that of another."""
    return {6: 8, 8: 6}.get(orientation, orientation)


def _register_heif(path: Path) -> None:
    try:
        import pillow_heif
    except ImportError:
        message = f"{path} is a HEIC photograph, which needs the package pillow-heif"
        cure = f"{INSTALL_PHOTOS}; or save the photographs as JPEG."
        raise refuse("missing-reader", message, cure, path.name) from None
    pillow_heif.register_heif_opener()


def _developed(path: Path, file: BinaryIO) -> Image.Image:
    """A RAW file at half its size, 8-bit sRGB without a tone curve, the camera's white balance."""
    try:
        import rawpy
    except ImportError:
        message = f"{path} is a RAW photograph, which needs the package rawpy"
        cure = f"{INSTALL_PHOTOS}; or develop the photographs, all with the same settings."
        raise refuse("missing-reader", message, cure, path.name) from None
    try:
        with rawpy.imread(file) as raw:
            _refuse_large(path, (raw.sizes.raw_width // 2, raw.sizes.raw_height // 2))
            how: Any = {"half_size": True, "use_camera_wb": True, "no_auto_bright": True}
            pixels = raw.postprocess(**how, output_bps=8, gamma=(2.4, 12.92))
    except (rawpy.LibRawError, OSError) as fault:  # type: ignore[attr-defined]
        raise _damaged(path, fault) from None
    # a monochrome sensor has one channel
    picture = Image.fromarray(np.broadcast_to(pixels, (*pixels.shape[:2], 3)))
    picture.info[DEVELOPED] = True
    # Most RAW files are TIFF as well, so the lens can be read; the picture is upright already.
    file.seek(0)
    with suppress(UnidentifiedImageError, *_BAD_EXIF), Image.open(file, formats=["TIFF"]) as stored:
        exif = stored.getexif()
        exif.get_ifd(ExifTags.IFD.Exif)
        exif.pop(ExifTags.Base.Orientation, None)
        picture.info["exif"] = exif.tobytes()
    return picture


def _damaged(path: Path, fault: Exception) -> CaptureRefusedError:
    message = f"{path} is truncated or damaged ({fault})"
    cure = "Copy it again from the camera, or remove it and its pose."
    return refuse("unreadable-images", message, cure, path.name)
