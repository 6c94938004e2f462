# SPDX-License-Identifier: Apache-2.0
"""Re-renders against photographs, and at the exposure of the photograph."""

from __future__ import annotations

import numpy as np
import pytest
from transport.shapes import looking_at, mesh_of, patch

from robir.capture.capture import View
from robir.evaluation.photos import Exposures, exposed, photo_scores
from robir.maths.tone import curve_from_name

SIZE = 32


def disc() -> tuple[np.ndarray, np.ndarray]:
    """Colours of a disc (H, W, 3), straight, and its soft coverage (H, W)."""
    rows, columns = np.mgrid[:SIZE, :SIZE] - (SIZE - 1) / 2
    coverage = np.clip(12.0 - np.hypot(rows, columns), 0, 1)
    colours = np.zeros((SIZE, SIZE, 3), np.uint8)
    colours[:] = [200, 120, 60]
    return colours, np.rint(255 * coverage).astype(np.uint8)


def view_of(colours: np.ndarray, mask: np.ndarray) -> View:
    camera = looking_at((0, 0, 3), size=SIZE)
    return View(name="a", image_display=colours, mask=mask, camera=camera, split="held_out")


def test_an_outline_that_both_cover_in_part_is_no_error():
    colours, mask = disc()
    again = np.dstack([colours + np.uint8(1), mask])
    scores = photo_scores(again, view_of(colours, mask))
    assert scores is not None
    assert abs(scores["psnr"] - 20 * np.log10(255)) < 1e-6


def test_what_the_rerender_lacks_counts_as_black():
    colours, mask = disc()
    half = mask * (np.arange(SIZE) < SIZE // 2)
    scores = photo_scores(np.dstack([colours, half]), view_of(colours, mask))
    assert scores is not None
    power = (np.array([200, 120, 60]) / 255) ** 2
    assert abs(scores["psnr"] + 10 * np.log10(power.mean() / 2)) < 0.2


def srgb(linear):
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)


def test_steps_are_factors_of_two_on_linear_light():
    linear = np.array([[[0.1, 0.2, 0.05]], [[0.3, 0.4, 0.4]]])
    alpha = np.full((2, 1, 1), 77)
    picture = np.dstack([np.rint(255 * srgb(linear)), alpha]).astype(np.uint8)
    again = exposed(picture, [1.0, 0.0, -1.0], curve_from_name("standard"))
    assert again.dtype == np.uint8 and (again[..., 3] == 77).all()
    expected = 255 * srgb(linear * [2.0, 1.0, 0.5])
    assert again[..., :3] == pytest.approx(expected, abs=1.6)
    white = exposed(picture, [3.0, 3.0, 3.0], curve_from_name("standard"))
    assert white[1, 0].tolist() == [255, 255, 255, 77]


def test_corners_and_own_exposure_are_undone_and_put_back():
    """A grey as bright everywhere as a camera shows it: brighter by its steps, darker outwards."""
    camera = looking_at((0, 0, 3), size=SIZE)
    rows, columns = np.mgrid[:SIZE, :SIZE] + 0.5 - SIZE / 2
    steps = 0.5 - 0.8 * (rows**2 + columns**2) / (SIZE**2 / 2)
    taken = np.repeat(255 * srgb(0.2 * 2.0**steps)[..., None], 3, axis=2)
    mask = np.full((SIZE, SIZE), 255, np.uint8)
    view = View(
        name="a",
        image_display=np.rint(taken).astype(np.uint8),
        mask=mask,
        camera=camera,
        split="train",
    )
    table = {
        "steps": {"a": [0.5, 0.5, 0.5]},
        "corner_steps": 0.8,
        "slope_steps": {},
        "other_light": [],
    }
    wall = mesh_of(patch((-9, -9, 0), (18, 0, 0), (0, 18, 0)))
    exposures = Exposures.of(table, {"family": "standard", "parameters": {}}, wall)
    even = exposures.evened(view).image_display
    assert even == pytest.approx(255 * srgb(np.full((SIZE, SIZE, 3), 0.2)), abs=1.5)
    again = exposures.as_photographed(even, view)
    assert again == pytest.approx(taken, abs=2.5)
    plain = Exposures.of(
        table | {"steps": {}, "corner_steps": 0.0}, {"family": "standard", "parameters": {}}, wall
    )
    assert plain.evened(view) is view and plain.as_photographed(even, view) is even
