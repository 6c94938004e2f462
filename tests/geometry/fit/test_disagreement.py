# SPDX-License-Identifier: Apache-2.0
"""Photographs that differ by their exposures, brought to one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray

from robir.capture.capture import Capture
from robir.capture.checks.photographs import exposure_offsets, sight
from robir.geometry.pipeline import equal_brightness
from tests.geometry.scenes import capture_of, disc, drum


def soft(points: NDArray[np.floating]) -> NDArray[np.floating]:
    """Colours that change slowly along the ground, none near black or white."""
    return 120.0 + 30.0 * np.sin(3.0 * points + [0.0, 1.0, 2.0])


def exposed(capture: Capture, steps: NDArray[np.floating]) -> Capture:
    """The same photographs, each so many steps brighter, under a plain power of 2.2."""
    views = []
    for view, step in zip(capture.views, steps, strict=True):
        display = np.rint(view.image_display * 2.0 ** (step / 2.2)).clip(0, 255)
        views.append(replace(view, image_display=display.astype(np.uint8)))
    return replace(capture, views=tuple(views))


def spread_of(capture: Capture) -> float:
    """Standard deviation of the training photographs' exposures, steps, as points tell it."""
    return float(exposure_offsets(sight(capture.train, capture.bounds)).std())


@pytest.fixture(scope="module")
def plain() -> Capture:
    scene = trimesh.util.concatenate([disc(), drum(0.3, -0.3, -0.1)])
    return capture_of(scene, views=24, side=64, low=0.3, paint=soft)


@pytest.fixture(scope="module")
def jittered(plain: Capture) -> Capture:
    return exposed(plain, 0.4 * np.random.default_rng(1).standard_normal(len(plain.views)))


def test_photographs_that_are_alike_stay_as_they_are(plain: Capture) -> None:
    assert equal_brightness(plain) is plain


def test_photographs_are_brought_to_one_exposure(plain: Capture, jittered: Capture) -> None:
    assert spread_of(jittered) > 0.2
    after = equal_brightness(jittered)
    assert spread_of(after) < 0.02
    for view, true in zip(after.train, plain.train, strict=True):
        inside = true.mask > 250
        found = view.image_display[inside].astype(float) - true.image_display[inside]
        assert np.abs(found - found.mean()).mean() < 3.0  # codes, up to one exposure for all


def test_held_out_photographs_are_not_touched(jittered: Capture) -> None:
    views = tuple(replace(v, split="test") if k == 3 else v for k, v in enumerate(jittered.views))
    after = equal_brightness(replace(jittered, views=views))
    assert after.views[3] is views[3]
    assert after.views[4] is not views[4]
