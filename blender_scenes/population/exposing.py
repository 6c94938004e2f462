# SPDX-License-Identifier: GPL-3.0-or-later
"""Holds a drawn exposure to what a photographer would accept: little clipped, nothing black."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from blender_scenes.format import ToneMapping, ViewTruth
from blender_scenes.population import ranges
from blender_scenes.view_transform import display_from_linear

STEP = 0.125
"""Stops by which the exposure is moved."""

FARTHEST = 6.0
"""Stops beyond which nothing is gained."""

MOST_PIXELS = 20_000


def held(views: Sequence[ViewTruth], tone: ToneMapping) -> ToneMapping:
    """The tone mapping with its exposure moved as little as it takes.

    Args:
        views: the training views.
        tone: as drawn.

    Returns:
        The same, dimmed until at most `ranges.CLIPPED` of the pixels are clipped; else brightened,
        as far as that allows, until half of them reach `ranges.LEAST_CODE`.
    """
    radiance = np.concatenate([view.radiance[view.mask > 0.5] for view in views])
    radiance = radiance[:: len(radiance) // MOST_PIXELS + 1]

    def codes(exposure: float) -> np.ndarray:
        """Codes (N, 3) of the pixels."""
        return 255.0 * display_from_linear(radiance, tone.view_transform, exposure, tone.look)

    def is_clipped(exposure: float) -> bool:
        return clipped_share(codes(exposure)) > ranges.CLIPPED[1]

    exposure = tone.exposure
    while is_clipped(exposure) and exposure > -FARTHEST:
        exposure -= STEP
    while (
        np.median(codes(exposure).max(axis=1)) < ranges.LEAST_CODE
        and exposure < FARTHEST
        and not is_clipped(exposure + STEP)
    ):
        exposure += STEP
    return replace(tone, exposure=exposure)


def clipped_share(codes: np.ndarray) -> float:
    """Share of pixels (N, 3) with a channel that is rounded to 255."""
    return float((codes >= 254.5).any(axis=1).mean())
