# SPDX-License-Identifier: Apache-2.0
"""Pixels of decoded pictures: what their codes mean, and 8-bit sRGB codes with straight alpha.

A file states its colours by an ICC profile, by code points (PNG's cICP, HEIC's nclx; ITU-T H.273),
by PNG's gAMA and cHRM, or by the EXIF mark of Adobe RGB; what states nothing is sRGB. LittleCMS
converts 8-bit codes of a profile. All else, and 16-bit codes, go through curve and matrix here in
32-bit numbers and are rounded once. Colours outside of sRGB are clipped.
"""

from __future__ import annotations

import io
import struct
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray
from PIL import ExifTags, Image, ImageCms

from robir.capture.images.linear import (
    D50,
    D65,
    REC709,
    Matrix,
    linear_from_srgb,
    rgb_to_rec709,
    srgb_codes,
    xyz_to_rec709,
)
from robir.capture.refusal import refuse

_PLAIN = ("L", "RGB", "CMYK")  # modes that LittleCMS is given
_BAND = 1 << 18  # pixels that are converted at a time
_MOST_CHUNKS = 64  # chunks of a PNG before its pixels that are looked at
MAX_PROFILE = 1 << 22  # largest profile, bytes; the tables of printers have two million
_ADOBE = ("Adobe RGB (by EXIF)", ((0.64, 0.33), (0.21, 0.71), (0.15, 0.06)), D65, 563 / 256)
_P3 = ((0.68, 0.32), (0.265, 0.69), (0.15, 0.06))
_REC709 = ("Rec.709", REC709, D65)
# name, primaries and white, CIE xy, by the code points of H.273; all others are as Rec.709
_PRIMARIES = {
    9: ("Rec.2020", ((0.708, 0.292), (0.17, 0.797), (0.131, 0.046)), D65),
    11: ("DCI-P3", _P3, (0.314, 0.351)),
    12: ("Display P3", _P3, D65),
}
_TRANSFER = {4: 2.2, 5: 2.8, 8: 1.0, 17: 2.6}  # exponents; video's curves are shown as sRGB's
HDR = {16: "PQ", 18: "HLG"}  # curves whose codes are no display values
_CMS_FAULTS = (ImageCms.PyCMSError, OSError, ValueError, TypeError)


@dataclass(frozen=True, slots=True, kw_only=True)
class Space:
    """Colours of a file: by matrix and curves, an ICC profile, both, or unknown."""

    name: str  # for the user
    matrix: Matrix | None = None  # (3, 3) linear values to linear Rec.709
    curves: tuple[Callable[[Matrix], Matrix], ...] = ()  # codes in 0..1 to linear values
    profile: bytes = b""  # ICC profile

    @property
    def is_known(self) -> bool:
        """Whether anything tells the way to sRGB."""
        return bool(self.profile or self.curves)


def space_of(picture: Image.Image) -> Space | None:
    """The colours that a picture states; None for those of sRGB, stated or not."""
    info: dict[Any, Any] = picture.info
    points, profile = info.get("cicp"), info.get("icc_profile")
    if points is None and not profile and (nclx := info.get("nclx_profile")):
        points = (nclx["color_primaries"], nclx["transfer_characteristics"])
    if points is not None:
        if points[1] in HDR:
            return Space(name=HDR[points[1]])
        return _of_primaries(*_PRIMARIES.get(points[0], _REC709), _TRANSFER.get(points[1], 0.0))
    if profile:
        mode = "L" if picture.mode in ("LA", "I;16") else picture.mode
        return _of_profile(bytes(profile), mode if mode in _PLAIN else "RGB")
    if "srgb" not in info and {"gamma", "chromaticity"} & set(info):
        gamma = float(info.get("gamma", 0.0)) or 1 / 2.2
        white, *primaries = np.reshape(info.get("chromaticity", (0,) * 8), (4, 2)).tolist()
        if not white[1]:
            _, primaries, white = _REC709
        gamma = 0.0 if abs(gamma - 1 / 2.2) < 0.01 else 1 / gamma
        return _of_primaries("PNG's gAMA and cHRM", primaries, white, gamma)
    return _of_primaries(*_ADOBE) if _is_adobe(picture) else None


def code_points(file: BinaryIO) -> dict[Any, Any]:
    """What a PNG's cICP chunk, which Pillow passes over, adds to its `info`."""
    at, found = file.tell(), {}
    file.seek(8)
    for _ in range(_MOST_CHUNKS):
        head = file.read(8)
        if len(head) < 8 or head[4:] == b"IDAT":
            break
        if head[4:] == b"cICP":
            found = {"cicp": tuple(file.read(2))}
            break
        file.seek(4 + int.from_bytes(head[:4], "big"), io.SEEK_CUR)
    file.seek(at)
    return found if len(found.get("cicp", ())) == 2 else {}


def name_of(picture: Image.Image) -> str:
    """What a picture that `space_of` finds to be sRGB says of itself."""
    is_stated = any(key in picture.info for key in ("icc_profile", "cicp", "nclx_profile", "srgb"))
    return "sRGB" if is_stated else "no colour profile (taken as sRGB)"


def converted(codes: NDArray[Any], space: Space) -> NDArray[np.uint8]:
    """8-bit sRGB codes of codes (H, W, 3), uint8 or uint16, of a space with a matrix."""
    most = np.iinfo(codes.dtype).max
    ramp = np.linspace(0.0, 1.0, most + 1)
    tables = [np.asarray(curve(ramp), np.float32) for curve in space.curves]
    matrix = np.asarray(space.matrix, np.float32).T
    result = np.empty(codes.shape, np.uint8)
    flat, out = codes.reshape(-1, 3), result.reshape(-1, 3)
    for first in range(0, len(flat), _BAND):
        part = flat[first : first + _BAND]
        linear = np.stack([table[part[:, i]] for i, table in enumerate(tables)], axis=1)
        out[first : first + _BAND] = srgb_codes(linear @ matrix)
    return result


def has_gain_map(picture: Image.Image) -> bool:
    """Whether a second picture says how much brighter the first may be shown."""
    is_stated = b"hdrgm" in bytes(picture.info.get("xmp", b""))
    return is_stated or any("gainmap" in str(kind) for kind in picture.info.get("aux", ()))


def by_profile(picture: Image.Image, space: Space) -> Image.Image:
    """A picture without alpha whose profile LittleCMS applies, 8-bit sRGB."""
    try:
        picture = picture if picture.mode in _PLAIN else picture.convert("RGB")
        return _transform(space.profile, picture.mode).apply(picture)  # type: ignore[union-attr]
    except _CMS_FAULTS:
        return picture.convert("RGB")


def _of_primaries(name: str, primaries: Any, white: Any, gamma: float) -> Space | None:
    """Colours by primaries, white and an exponent, 0 for sRGB's curve."""
    try:
        matrix = rgb_to_rec709(primaries, white)
    except (np.linalg.LinAlgError, ZeroDivisionError):
        return None
    if not gamma and np.abs(matrix - np.eye(3)).max() < 0.01:
        return None
    curve = (lambda code: code**gamma) if gamma else linear_from_srgb
    return Space(name=name, matrix=matrix, curves=(curve,) * 3)


def _is_adobe(picture: Image.Image) -> bool:
    """Whether EXIF says Adobe RGB, as cameras do that write no profile (DCF 2.0)."""
    if not picture.info.get("exif"):
        return False
    try:
        exif = picture.getexif()
        return exif.get_ifd(ExifTags.IFD.Interop).get(1) == "R03"
    except (*_CMS_FAULTS, SyntaxError, LookupError, AttributeError, struct.error):
        return False


@lru_cache(maxsize=64)
def _of_profile(profile: bytes, mode: str) -> Space | None:
    """Colours by an ICC profile; None where all of them are those of sRGB."""
    try:
        if len(profile) > MAX_PROFILE:
            raise ValueError
        described = ImageCms.getProfileDescription(_opened(profile)).strip()
        name = described.splitlines()[0][:60] if described else "an unnamed profile"
        _transform(profile, mode)
    except _CMS_FAULTS:
        return Space(name="a damaged colour profile (taken as sRGB)")
    if mode == "RGB":
        cube = np.stack(np.meshgrid(*[np.linspace(0, 255, 9)] * 3), axis=-1).astype(np.uint8)
        shown = _transform(profile, mode).apply(Image.fromarray(cube.reshape(27, 27, 3)))  # type: ignore[union-attr]
        if np.abs(np.asarray(shown, int) - cube.reshape(27, 27, 3)).max() <= 1:
            return None
    matrix, curves = _matrix_and_curves(profile)
    return Space(name=name, profile=profile, matrix=matrix, curves=curves)


def _opened(profile: bytes) -> ImageCms.ImageCmsProfile:
    return ImageCms.ImageCmsProfile(io.BytesIO(profile))


@lru_cache(maxsize=64)
def _transform(profile: bytes, mode: str) -> ImageCms.ImageCmsTransform:
    intent, target = ImageCms.Intent.RELATIVE_COLORIMETRIC, ImageCms.createProfile("sRGB")
    return ImageCms.buildTransform(_opened(profile), target, mode, "RGB", intent)


def _matrix_and_curves(profile: bytes) -> tuple[Matrix | None, tuple[Any, ...]]:
    """Matrix to linear Rec.709 and curves of a profile that has no more than these (ICC.1)."""
    try:
        (count,) = struct.unpack_from(">I", profile, 128)
        table = profile[132 : 132 + 12 * count]
        tags = {n: profile[at : at + size] for n, at, size in struct.iter_unpack(">4sII", table)}
        if b"A2B0" in tags:
            return None, ()
        columns = [struct.unpack_from(">3i", tags[c + b"XYZ"], 8) for c in (b"r", b"g", b"b")]
        curves = tuple(_profile_curve(tags[c + b"TRC"]) for c in (b"r", b"g", b"b"))
    except (struct.error, KeyError, ValueError, ZeroDivisionError):
        return None, ()
    return xyz_to_rec709(D50) @ (np.array(columns).T / 65536), curves


def _profile_curve(tag: bytes) -> Callable[[Matrix], Matrix]:
    """A profile's curve: an exponent, a table or a formula with a straight part."""
    kind, count = tag[:4], struct.unpack_from(">I", tag, 8)[0]
    if kind == b"curv" and count > 1:
        table = np.frombuffer(tag, ">u2", count, 12) / 65535
        return lambda code: np.interp(code, np.linspace(0.0, 1.0, count), table)
    if kind == b"curv":
        g = struct.unpack_from(">H", tag, 12)[0] / 256 if count else 1.0
        return lambda code: code**g
    form = count >> 16
    if kind != b"para" or form > 4:
        raise ValueError("no curve that is known")
    stated = (np.frombuffer(tag, ">i4", (1, 3, 4, 5, 7)[form], 12) / 65536).tolist()
    g, a, b, c, d, e, f = (*stated, *[0.0] * 6)[:7]
    if form == 0:
        a = 1.0
    elif form < 3:
        c, d, e, f = 0.0, -b / a, c, c
    return lambda code: np.where(code >= d, np.maximum(a * code + b, 0.0) ** g + e, c * code + f)


Bytes = NDArray[np.uint8]

_FEWEST = 20  # soft pixels by which colours multiplied by alpha are recognised


@dataclass(frozen=True, slots=True, kw_only=True)
class Photo:
    """A photograph as stored."""

    image_display: Bytes  # (H, W, 3) uint8, display-referred, straight
    alpha: Bytes | None  # (H, W) uint8, or None if the file is opaque throughout
    orientation: int  # EXIF orientation that was applied, 1 to 8; 1 if none was
    reduction: int = 1  # pixels of the file, along rows and columns, in one of these
    colours: tuple[str, ...] = ()  # what was found of its colours, and done, for the user
    is_linear: bool = False  # whether no tone curve but sRGB's was applied

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in pixels."""
        return self.image_display.shape[1], self.image_display.shape[0]


def _array_of(picture: Image.Image, mode: str) -> Bytes:
    """Pixels in a mode; Pillow would copy those that have it already once more."""
    return np.array(picture if picture.mode == mode else picture.convert(mode))


def pixels_of(picture: Image.Image, turn: int = 1) -> Photo:
    """Pixels of a decoded picture, turned as EXIF said, as 8-bit RGB and alpha."""
    if picture.mode.startswith("I"):  # 16-bit grey
        grey = _eight_bits(np.clip(np.asarray(picture), 0, 65535))
        image = np.repeat(grey[:, :, None], 3, axis=2)
        return Photo(image_display=image, alpha=None, orientation=turn)
    if not picture.has_transparency_data:
        image = _array_of(picture, "RGB")
        return Photo(image_display=image, alpha=None, orientation=turn)
    pixels = _array_of(picture, "RGBA")
    image, alpha = (np.ascontiguousarray(part) for part in (pixels[:, :, :3], pixels[:, :, 3]))
    opaque = alpha.min(initial=255) == 255
    return Photo(image_display=image, alpha=None if opaque else alpha, orientation=turn)


def in_srgb(
    picture: Image.Image, deep: NDArray[np.uint16] | None, path: Path
) -> tuple[Image.Image, tuple[str, ...]]:
    """A picture in 8-bit sRGB with straight alpha, by its 16-bit codes if any, and its colours."""
    space = space_of(picture)
    if space is not None and space.name in HDR.values():
        message = f"{path} holds HDR codes ({space.name}), which are no display values"
        cure = "Export it as a standard photograph (SDR), or linearly as EXR."
        raise refuse("hdr-colours", message, cure, path.name)
    facts = [name_of(picture) if space is None else space.name]
    if space is not None and space.is_known and not picture.mode.startswith("I"):
        facts = [f"{space.name} (converted to sRGB)"]
    else:
        space = None
    if has_gain_map(picture):
        facts.append("an HDR gain map (the base picture is taken)")
    has_alpha, codes = picture.has_transparency_data, deep
    if codes is None and not has_alpha and (space is None or space.profile):
        return (picture if space is None else by_profile(picture, space)), tuple(facts)
    if codes is None:
        codes = _array_of(picture, "RGBA" if has_alpha else "RGB")
    if codes.shape[2] == 4 and is_premultiplied(codes):
        codes = straight_codes(codes)
        facts.append("colours multiplied by alpha (divided again)")
    elif space is None and deep is None:
        return picture, tuple(facts)
    colour, alpha = codes[:, :, :3], codes[:, :, 3:]
    if space is not None and space.curves and (deep is not None or not space.profile):
        shown = converted(colour, space)
    else:
        shown = _eight_bits(colour)
        if space is not None:
            shown = np.asarray(by_profile(Image.fromarray(shown), space))
    return Image.fromarray(np.dstack([shown, _eight_bits(alpha)])), tuple(facts)


def _eight_bits(codes: NDArray[Any]) -> Bytes:
    """Codes of 8 or 16 bits as the nearest of 8; 65535 / 255 = 257."""
    if codes.dtype == np.uint8:
        return np.ascontiguousarray(codes)
    return ((codes.astype(np.int32) + 128) // 257).astype(np.uint8)


def is_premultiplied(codes: NDArray[Any]) -> bool:
    """Whether colours (H, W, 4) are below alpha throughout, and darker where that is soft."""
    most = np.iinfo(codes.dtype).max
    brightest, alpha = codes[:, :, :3].max(axis=2), codes[:, :, 3]
    soft, full = (alpha > 0) & (alpha < most), alpha == most
    if (brightest > alpha).any() or soft.sum() < _FEWEST or not full.any():
        return False
    share = float(alpha[soft].mean()) / most
    # brightness of the soft pixels: that of the object if straight, else a share of it
    return float(brightest[soft].mean()) < np.sqrt(share) * float(brightest[full].mean())


def straight_codes(codes: NDArray[Any]) -> NDArray[Any]:
    """Codes (H, W, 4) with colours, none above its alpha, divided by alpha."""
    most = np.iinfo(codes.dtype).max
    alpha = np.maximum(codes[:, :, 3:], 1).astype(np.float32)
    colour = np.rint(codes[:, :, :3] * (np.float32(most) / alpha)).astype(codes.dtype)
    return np.dstack([colour, codes[:, :, 3]])
