# SPDX-License-Identifier: Apache-2.0
"""Photographs whose values are light itself: OpenEXR, and TIFF with floating-point numbers.

They went through no tone curve. Their primaries are Rec.709 unless an EXR states others.
"""

from __future__ import annotations

import io
import logging
import math
from collections.abc import Iterable
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import OpenEXR
import tifffile
from numpy.typing import NDArray
from PIL import Image

from robir.capture.images.opencv import cv2

Matrix = NDArray[np.float64]

D50, D65 = (0.3457, 0.3585), (0.3127, 0.3290)  # whites, CIE xy

# red, green and blue of Rec.709 and sRGB, CIE xy; their white is D65
REC709 = ((0.64, 0.33), (0.30, 0.60), (0.15, 0.06))

_BRADFORD = np.array(
    [[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]]
)


def rgb_to_rec709(primaries: Any, white: Any) -> Matrix:
    """Linear values of primaries and a white, CIE xy, to linear Rec.709, (3, 3)."""
    return xyz_to_rec709(white) @ _to_xyz(primaries, white)


def xyz_to_rec709(white: Any) -> Matrix:
    """XYZ under a white, CIE xy, to linear Rec.709, (3, 3)."""
    gains = (_BRADFORD @ _xyz(D65)) / (_BRADFORD @ _xyz(white))
    adapted = np.linalg.solve(_BRADFORD, gains[:, None] * _BRADFORD)
    return np.linalg.solve(_to_xyz(REC709, D65), adapted)


def linear_from_srgb(code: Matrix) -> Matrix:
    """Linear values of sRGB codes in [0, 1]."""
    return np.where(code <= 0.04045, code / 12.92, ((code + 0.055) / 1.055) ** 2.4)


def srgb_codes(linear: NDArray[Any]) -> NDArray[np.uint8]:
    """8-bit sRGB codes of linear Rec.709 values; what lies outside is clipped."""
    value = np.clip(np.nan_to_num(linear), 0.0, 1.0)
    curved = 1.055 * np.maximum(value, 0.0031308) ** (1 / 2.4) - 0.055
    return np.rint(255 * np.where(value <= 0.0031308, 12.92 * value, curved)).astype(np.uint8)


def _to_xyz(primaries: Any, white: Any) -> Matrix:
    """Linear values to XYZ under their own white."""
    columns = np.array([_xyz(point) for point in primaries]).T
    return columns * np.linalg.solve(columns, _xyz(white))


def _xyz(point: Any) -> Matrix:
    x, y = point
    return np.array([x / y, 1.0, (1 - x - y) / y])


Floats = NDArray[np.float32]

LINEAR = "linear"  # in a picture's `info`: linear Rec.709 values, (H, W, 3 or 4) float32, straight
BRIGHT = 0.995  # share of the pixels that have to be below white
_STEP = 7  # every how many-th pixel is looked at for that
_MAX_VALUES = 1 << 17  # of an entry of a TIFF: a picture of 65,535 rows has as many strips
_EXIF, _FLOATING, _TEXTS = 34665, 3, (1, 2, 7)  # of these kinds entries stay bytes

logging.getLogger("tifffile").setLevel(logging.CRITICAL)  # what is wrong is said in refusals


def read_linear(path: Path, file: BinaryIO, most: int) -> Image.Image:
    """A picture with linear values from an EXR or TIFF of so many pixels at most, or ValueError."""
    try:
        values = _exr(path, most) if path.suffix.lower() == ".exr" else _tiff(file, most)
    except (RuntimeError, KeyError, TypeError, AssertionError) as fault:
        raise ValueError(str(fault)) from None
    if values.ndim != 3 or values.shape[2] not in (3, 4):
        raise ValueError("its channels are no colours")
    return _picture(np.nan_to_num(values, nan=0.0, posinf=65504.0, neginf=0.0))


def is_floating_tiff(file: BinaryIO) -> bool:
    """Whether a file is a TIFF of floating-point numbers; ValueError for endless entries."""
    counts, is_floating = {}, False
    try:
        if file.read(4) in (b"II*\0", b"MM\0*"):
            file.seek(0)
            with tifffile.TiffFile(file, name="photograph") as opened:
                page = opened.pages.first
                is_floating = page.sampleformat == _FLOATING
                counts = {tag.name: tag.count for tag in page.tags if tag.dtype not in _TEXTS}
                exif = page.tags.valueof(_EXIF, {})
                counts |= {key: len(v) for key, v in exif.items() if isinstance(v, tuple)}
    except Exception:  # a foreign parser on foreign bytes may raise anything
        return False  # what is wrong, the decoder says
    finally:
        file.seek(0)
    endless = next((name for name, count in counts.items() if count > _MAX_VALUES), None)
    if endless is not None:
        raise ValueError(f"its entry {endless} has {counts[endless]} numbers")
    return is_floating


def coded(picture: Image.Image, exposure: float) -> Image.Image:
    """A linear picture as 8-bit sRGB codes, its values times an exposure first."""
    return _picture(picture.info[LINEAR], exposure)


def common_exposure(pictures: Iterable[Image.Image]) -> float:
    """The power of two that brings nearly all values of linear pictures below white."""
    tops = [_top(picture.info[LINEAR]) for picture in pictures]
    top = max(tops, default=1.0)
    return 1.0 if 0.25 < top <= 1.0 or top <= 0.0 else 2.0 ** -math.ceil(math.log2(top))


def _top(values: Floats) -> float:
    part = values.reshape(-1, values.shape[2])[::_STEP]
    shown = part[part[:, 3] > 0.5] if values.shape[2] == 4 else part
    return float(np.quantile(shown[:, :3].max(axis=1), BRIGHT)) if len(shown) else 0.0


def _picture(values: Floats, exposure: float = 1.0) -> Image.Image:
    layers = srgb_codes(values[:, :, :3] * np.float32(exposure))
    if values.shape[2] == 4:
        alpha = np.rint(255 * np.clip(values[:, :, 3:], 0.0, 1.0)).astype(np.uint8)
        layers = np.dstack([layers, alpha])
    picture = Image.fromarray(layers)
    picture.info[LINEAR] = values
    return picture


def _exr(path: Path, most: int) -> Floats:
    with OpenEXR.File(str(path), header_only=True) as opened:
        header: dict[str, Any] = dict(opened.header())  # closing empties its own
    low, high = (np.asarray(edge) for edge in header["dataWindow"])
    frame, end = (np.asarray(edge) for edge in header["displayWindow"])
    (columns, rows), (width, height) = high - low + 1, end - frame + 1
    if max(columns * rows, width * height) > most or min(width, height) < 1:
        raise ValueError(f"it has {width}x{height} pixels")
    with OpenEXR.File(str(path), separate_channels=True) as opened:
        channels = {n: np.asarray(c.pixels, np.float32) for n, c in opened.channels().items()}
    prefix = next((n[:-1] for n in sorted(channels, key=len) if n.split(".")[-1] == "R"), "")
    names = [prefix + axis for axis in "RGB"] if prefix + "R" in channels else ["Y"] * 3
    colour = np.stack([channels[name] for name in names], axis=-1)
    if "chromaticities" in header:
        red, green, blue, white = np.reshape(header["chromaticities"], (4, 2)).tolist()
        colour = colour @ rgb_to_rec709((red, green, blue), white).T.astype(np.float32)
    if prefix + "A" in channels:  # colours of EXR are multiplied by alpha
        alpha = channels[prefix + "A"][:, :, None]
        colour = np.dstack([colour / np.maximum(alpha, 1e-6), alpha])
    whole = np.zeros((height, width, colour.shape[2]), np.float32)
    (x0, y0), (x1, y1) = np.maximum(low, frame), np.minimum(high, end) + 1
    part = colour[y0 - low[1] : y1 - low[1], x0 - low[0] : x1 - low[0]]
    whole[y0 - frame[1] : y1 - frame[1], x0 - frame[0] : x1 - frame[0]] = part
    return whole


def _tiff(file: BinaryIO, most: int) -> Floats:
    content = file.read()
    with tifffile.TiffFile(io.BytesIO(content)) as opened:
        page = opened.pages.first
        if page.imagewidth * page.imagelength > most:
            raise ValueError(f"it has {page.imagewidth}x{page.imagelength} pixels")
        try:
            values = np.asarray(page.asarray(), np.float32)
        except ValueError:  # a compression that OpenCV may know
            values = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED)
            if values is None or page.dtype != np.float32:
                raise
            if values.ndim == 3:
                values = values[:, :, [2, 1, 0, 3][: values.shape[2]]]
    if values.ndim == 3 and values.shape[2] not in (3, 4):  # a plane for each channel
        values = np.moveaxis(values, 0, 2)
    return np.repeat(values[:, :, None], 3, axis=2) if values.ndim == 2 else values
