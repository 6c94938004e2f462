# SPDX-License-Identifier: GPL-3.0-or-later
"""The image that shows a reconstruction as it grows, beside the photograph it should match."""

from pathlib import Path

import bpy
import numpy as np

PREVIEW = "RobIR preview"
"""Name of the image."""


def forget() -> None:
    """Take the image of an earlier reconstruction away."""
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
    if not bpy.app.background:
        _refresh_icon(image)
    return changed


def _refresh_icon(image: bpy.types.Image) -> None:
    """Give an image's icon the image's pixels; Blender makes an icon once and keeps it."""
    width, height = image.size
    if not width or not height:
        return
    pixels = np.empty(4 * width * height, np.float32)
    image.pixels.foreach_get(pixels)
    icon = image.preview_ensure()
    icon.image_size = (width, height)
    icon.image_pixels_float.foreach_set(pixels)
