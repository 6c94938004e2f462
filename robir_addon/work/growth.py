# SPDX-License-Identifier: GPL-3.0-or-later
"""A photograph, and beside it what a reconstruction makes of it so far: as image and as icons."""

from pathlib import Path
from typing import Any

import bpy
import bpy.utils.previews
import numpy as np

PREVIEW = "RobIR preview"
"""Name of the image."""

_HALVES = ("photograph", "reconstruction")

_both: list[dict[str, Any]] = []
"""Blender's collection of the two icons, once there is a picture."""


def forget() -> None:
    """Take the image and the icons of an earlier reconstruction away."""
    unregister()
    before = bpy.data.images.get(PREVIEW)
    if before is not None:
        bpy.data.images.remove(before)


def load_newer(path: Path, known: int) -> int:
    """Read the picture again if there is a newer one.

    Args:
        path: The picture; it may be missing.
        known: What this function returned last, 0 at first.

    Returns:
        When the picture that is shown was written, nanoseconds.
    """
    try:
        changed = path.stat().st_mtime_ns
    except OSError:
        return known
    if changed == known:
        return known
    image = bpy.data.images.get(PREVIEW)
    if image is None:
        try:
            image = bpy.data.images.load(str(path))
        except RuntimeError:  # removed or replaced this very moment; the next look tells
            return known
        image.name = PREVIEW
    else:
        image.reload()
    _refresh_icons(image)
    return changed


def icons() -> list[int]:
    """Icons of the photograph and of the reconstruction; none before there is a picture."""
    return [icon.icon_id for icon in _both[0].values()] if _both else []


def unregister() -> None:
    """Give the icons back."""
    while _both:
        bpy.utils.previews.remove(_both.pop())


def _refresh_icons(image: bpy.types.Image) -> None:
    """Give the icons the pixels of the image's left and right half."""
    width, height = image.size
    if width < 2 or not height:
        return
    pixels = np.empty((height, width, 4), np.float32)
    image.pixels.foreach_get(pixels.reshape(-1))
    if not _both:
        icons_of = bpy.utils.previews.new()
        for half in _HALVES:
            icons_of.new(half)
        _both.append(icons_of)
    middle = width // 2
    for half, part in zip(_HALVES, (pixels[:, :middle], pixels[:, -middle:]), strict=True):
        icon = _both[0][half]
        icon.image_size = (middle, height)
        icon.image_pixels_float.foreach_set(np.ascontiguousarray(part).reshape(-1))
