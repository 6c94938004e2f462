# SPDX-License-Identifier: Apache-2.0
"""Colours that a curve cannot show rule it out."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from robir.appearance.tone.choose import share_beyond, unable
from robir.maths.tone import curve_from_name
from robir.transport.observe import Observations

FAMILIES = ("standard", "filmic", "agx", "khronos_pbr_neutral", "robir_aces")


def shown(display: np.ndarray) -> Observations:
    """One point a row, seen by one view, of display codes (N, 3)."""
    count = len(display)
    codes = display.astype(np.uint8)[:, None]
    return Observations(
        display=codes,
        weight=np.ones((count, 1), np.float32),
        clipped=codes == 255,
        off_axis=np.zeros((count, 1), np.uint8),
        positions=np.zeros((1, 3), np.float32),
        views=("only",),
    )


def photographed(family: str) -> Observations:
    """Every hue and saturation of paint in light of ten stops, through a curve."""
    rng = np.random.default_rng(4)
    paint = rng.uniform(0.02, 0.9, (4000, 3)) ** rng.uniform(0.3, 2.0, (4000, 1))
    linear = paint * 2.0 ** rng.uniform(-6, 4, (4000, 1))
    display = curve_from_name(family).display_from_linear(torch.from_numpy(linear).float())
    return shown(np.rint(255 * display.clamp(0, 1).numpy()))


@pytest.mark.parametrize("family", FAMILIES)
def test_a_curve_shows_what_went_through_it(family):
    assert share_beyond(curve_from_name(family), photographed(family)) == 0


def test_saturated_paint_in_strong_light_did_not_go_through_agx():
    beyond = unable([curve_from_name(name) for name in FAMILIES], photographed("standard"))
    assert set(beyond) >= {"agx"}
    assert set(beyond) <= {"agx", "khronos_pbr_neutral"}
    assert beyond["agx"] > 0.05


def test_grey_went_through_any_curve():
    grey = np.repeat(np.arange(1, 255)[:, None], 3, axis=1)
    assert unable([curve_from_name(name) for name in FAMILIES], shown(grey)) == {}
