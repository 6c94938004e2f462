# SPDX-License-Identifier: Apache-2.0
"""The part of a photograph that shows the object: pixels are for it, not for its surroundings."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from robir.capture.bounds import INSIDE
from robir.capture.camera import Box

# width of the strip of background that is kept about the object, against the longer side of what is
# kept: the outline is soft, and what lies beside it tells what is empty
MARGIN = 0.05
LEAST_SAVED = 0.25  # share of the photograph's longer side that cutting must take off to be done
# longer side of photographs, pixels, that no stage reduces: cutting would gain nothing
NEVER_REDUCED = 256


def object_box(mask: NDArray[np.uint8]) -> Box | None:
    """The part of a picture about its object.

    Args:
        mask: (H, W) uint8 coverage.

    Returns:
        The mask's bounding box with a margin, but for sides where the picture ends; None where
        the whole picture is hardly larger, or the mask is empty.
    """
    inside = mask >= INSIDE
    rows, columns = np.flatnonzero(inside.any(axis=1)), np.flatnonzero(inside.any(axis=0))
    if len(rows) == 0:
        return None
    height, width = mask.shape
    longer = max(rows[-1] - rows[0], columns[-1] - columns[0]) + 1
    margin = math.ceil(MARGIN * longer)
    left, right = max(0, columns[0] - margin), min(width, columns[-1] + 1 + margin)
    top, bottom = max(0, rows[0] - margin), min(height, rows[-1] + 1 + margin)
    if max(right - left, bottom - top) > (1.0 - LEAST_SAVED) * max(width, height):
        return None
    return int(left), int(top), int(right), int(bottom)


def scaled_box(box: Box, small: tuple[int, int], large: tuple[int, int]) -> Box:
    """The part of a large picture that holds a part of its small copy.

    Args:
        box: Of the small copy.
        small: Its width and height.
        large: Those of the picture.
    """
    (left, top, right, bottom), x, y = box, large[0] / small[0], large[1] / small[1]
    return (
        math.floor(left * x),
        math.floor(top * y),
        min(large[0], math.ceil(right * x)),
        min(large[1], math.ceil(bottom * y)),
    )
