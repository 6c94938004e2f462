# SPDX-License-Identifier: Apache-2.0
"""Pixels of decoded pictures: 8-bit sRGB codes, straight alpha."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from robir.capture.images.colour import HDR, by_profile, converted, has_gain_map, name_of, space_of
from robir.capture.refusal import refuse

Bytes = NDArray[np.uint8]

_FEWEST = 20  # soft pixels by which colours multiplied by alpha are recognised


@dataclass(frozen=True, slots=True, kw_only=True)
class Photo:
    """A photograph as stored."""

    image_display: Bytes  # (H, W, 3) uint8, display-referred, straight
    # (H, W) uint8, or None if the file has no transparency or is opaque throughout
    alpha: Bytes | None
    orientation: int  # EXIF orientation that was applied, 1 to 8; 1 if none was
    # how many pixels of the file, along rows and columns, went into one of these
    reduction: int = 1
    colours: tuple[str, ...] = ()  # what was found of its colours, and done, for the user
    # whether it is light itself, to which no tone curve but sRGB's was applied
    is_linear: bool = False

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
    """A decoded picture in 8-bit sRGB with straight alpha, and what was found of its colours.

    `deep` holds its pixels where they have 16 bits, as `deep_codes` has them.
    """
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
    """Whether no pixel (H, W, 4) has a channel above its alpha, and soft pixels are as much darker.

    The second is for dark objects, whose straight colours are below nearly any alpha.
    """
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
