# SPDX-License-Identifier: Apache-2.0
"""The picture by which a user follows a run: a photograph, and beside it what is known so far."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from robir.capture.images.loading import size_within
from robir.jobs.paths import replacing

MAX_SIDE = 160  # longer side of each of the two pictures, pixels
BACKGROUND = 48  # grey behind the object, display value


def save_preview(path: Path, photo: NDArray[np.uint8], rendering: NDArray[np.uint8]) -> None:
    """Write a photograph and, to its right, the same view as reconstructed, as PNG.

    Both are (H, W, 4) display RGB, straight alpha = coverage of the object.
    """
    size = size_within((photo.shape[1], photo.shape[0]), MAX_SIDE)
    sheet = Image.new("RGB", (2 * size[0], size[1]), (BACKGROUND,) * 3)
    for column, picture in enumerate((photo, rendering)):
        small = Image.fromarray(picture, "RGBA").resize(size, Image.Resampling.BOX)
        sheet.paste(small, (column * size[0], 0), small)
    with replacing(path) as temporary:
        sheet.save(temporary, format="PNG", compress_level=1)
