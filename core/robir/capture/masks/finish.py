# SPDX-License-Identifier: Apache-2.0
"""From a small doubtful mask to the outline in the full photograph."""

from __future__ import annotations

import numpy as np

from robir.capture.images.opencv import cv2
from robir.capture.masks.sight import Bytes, Layer, to_lab
from robir.capture.masks.walker import walk

BAND = 2  # pixels on both sides of the outline that are looked at anew at each size
STEPS = 16  # steps of the solver: belief has only a few pixels to go


def sharpened(image_display: Bytes, belief: Layer) -> Bytes:
    """Mask of a photograph whose outline follows the photograph's edges.

    The size doubles from that of the belief to that of the photograph; each time only the pixels
    next to the outline are decided again.

    Args:
        image_display: (H, W, 3) uint8, the photograph.
        belief: (h, w) in [0, 1], the same picture smaller.

    Returns:
        (H, W) uint8, 255 on the object.
    """
    height, width = image_display.shape[:2]
    belief = _largest(belief)
    rows, columns = np.nonzero(belief > 0.5)
    mask = np.zeros((height, width), np.uint8)
    if len(rows) == 0:
        return mask
    # only the part of the photograph about the object
    scale = np.array([height / belief.shape[0], width / belief.shape[1]])
    low = np.maximum(np.array([rows.min(), columns.min()]) - 4, 0)
    high = np.minimum(np.array([rows.max(), columns.max()]) + 5, belief.shape)
    belief = belief[low[0] : high[0], low[1] : high[1]]
    top, left = np.rint(low * scale).astype(int)
    bottom, right = np.rint(high * scale).astype(int)
    part = image_display[top:bottom, left:right]
    while belief.shape != part.shape[:2]:
        size = (min(2 * belief.shape[1], part.shape[1]), min(2 * belief.shape[0], part.shape[0]))
        if part.shape[1] <= 2.6 * belief.shape[1]:
            size = (part.shape[1], part.shape[0])
        belief = cv2.resize(belief, size, interpolation=cv2.INTER_LINEAR)
        inside = (belief > 0.5).astype(np.uint8)
        square = np.ones((2 * BAND + 1, 2 * BAND + 1), np.uint8)
        known = cv2.dilate(inside, square) == cv2.erode(inside, square)
        belief = np.where(known, inside.astype(np.float32), belief)
        lab = to_lab(cv2.resize(part, size, interpolation=cv2.INTER_AREA))
        belief = walk(lab, belief, known, STEPS)
    mask[top:bottom, left:right] = np.where(belief > 0.5, 255, 0)
    return mask


def _largest(belief: Layer) -> Layer:
    """Belief without pieces and holes of less than a thousandth of the mask."""
    belief = belief.copy()
    for inside in (True, False):
        layer = ((belief > 0.5) == inside).astype(np.uint8)
        _, pieces, facts, _ = cv2.connectedComponentsWithStats(layer, connectivity=8)
        least = max(4.0, 1e-3 * float((belief > 0.5).sum()))
        small = facts[:, cv2.CC_STAT_AREA] < least
        belief = np.where((layer == 1) & small[pieces], np.float32(not inside), belief)
    return belief
