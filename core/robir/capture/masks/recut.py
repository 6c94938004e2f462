# SPDX-License-Identifier: Apache-2.0
"""Guessed masks cut again, once a surface tells roughly where the object ends.

Colours alone cannot tell a shadow from the object that casts it, nor a wall between arm and body
from the body; a surface can, to within a few pixels. Within these, colours and edges decide.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from robir.capture.masks.colours import Palette
from robir.capture.masks.sight import Layer, Picture
from robir.capture.masks.walker import walk

LESSON = 2.0  # pixels from the surface's outline within which a pixel teaches little of either side
# pixels by which the surface's outline may be off for one unit of evidence, natural logarithm of a
# ratio; colours tell at most four
WIDTH = 1.5
# evidence, natural logarithm of a ratio, beyond which a float's belief says the same
MOST_EVIDENCE = 30.0


def recut(pictures: Sequence[Picture], outlines: Sequence[Layer]) -> list[Layer]:
    """Cut the object out of photographs near the outlines of a surface.

    Args:
        pictures: Photographs.
        outlines: (H, W) signed distances of each picture's pixels to the outline of the surface,
            pixels, negative on it.

    Returns:
        Belief in the object at each pixel, (H, W) in [0, 1].
    """
    lessons = [_belief(-outline / LESSON) for outline in outlines]
    palette = Palette(pictures, lessons)
    masks = []
    for index, (picture, outline) in enumerate(zip(pictures, outlines, strict=True)):
        evidence = palette.evidence(index, outline.shape) - outline / WIDTH
        masks.append(walk(picture.lab, _belief(evidence)))
    return masks


def _belief(evidence: Layer) -> Layer:
    bounded = np.clip(evidence, -MOST_EVIDENCE, MOST_EVIDENCE)
    return (1 / (1 + np.exp(-bounded))).astype(np.float32)
