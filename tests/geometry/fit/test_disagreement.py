# SPDX-License-Identifier: Apache-2.0
"""Photographs that differ by their exposures or by noise, and the ground told by them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
import torch
import trimesh
from numpy.typing import NDArray
from scipy.ndimage import binary_opening

from robir.capture.camera import Camera
from robir.capture.capture import Capture
from robir.capture.checks.sightings import sight
from robir.capture.checks.uneven_exposure import exposure_offsets
from robir.geometry import settling
from robir.geometry.brightness import evened
from robir.geometry.config import GeometryConfig
from robir.geometry.ground import backdrop
from robir.geometry.ground.backdrop import Backdrop, pixel_noise
from robir.geometry.ground.flatten import Ground
from robir.geometry.ground.plane import detect
from robir.geometry.hull import carve, hull_of
from robir.geometry.rays import Photo, RaySampler, reduce_view
from robir.geometry.stage import reconstruct
from tests.geometry.scenes import capture_of, checker, disc, drum

COVERED = backdrop._NOISE_COVERAGE

NOISE = 0.03
"""Standard deviation of the noise in the tests, display."""


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


def noisy(photo: Photo, rng: np.random.Generator) -> Photo:
    """The photograph with noise wherever it shows something."""
    grain = NOISE * rng.standard_normal(photo.premultiplied_display.shape)
    display = photo.premultiplied_display + grain * (photo.coverage[..., None] > 0)
    return replace(photo, premultiplied_display=display.clip(0, 1).astype(np.float32))


@pytest.fixture(scope="module")
def plain() -> Capture:
    scene = trimesh.util.concatenate([disc(), drum(0.3, -0.3, -0.1)])
    return capture_of(scene, views=24, side=64, low=0.3, paint=soft)


@pytest.fixture(scope="module")
def jittered(plain: Capture) -> Capture:
    return exposed(plain, 0.4 * np.random.default_rng(1).standard_normal(len(plain.views)))


def test_photographs_that_are_alike_stay_as_they_are(plain: Capture) -> None:
    assert evened(plain) is plain


def test_photographs_are_brought_to_one_exposure(plain: Capture, jittered: Capture) -> None:
    assert spread_of(jittered) > 0.2
    after = evened(jittered)
    assert spread_of(after) < 0.02
    for view, true in zip(after.train, plain.train, strict=True):
        inside = true.mask > 250
        found = view.image_display[inside].astype(float) - true.image_display[inside]
        assert np.abs(found - found.mean()).mean() < 3.0  # codes, up to one exposure for all


def test_held_out_photographs_are_not_touched(jittered: Capture) -> None:
    views = tuple(replace(v, split="test") if k == 3 else v for k, v in enumerate(jittered.views))
    after = evened(replace(jittered, views=views))
    assert after.views[3] is views[3]
    assert after.views[4] is not views[4]


def test_the_surface_is_fitted_to_photographs_of_one_exposure(
    jittered: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    spreads: list[float] = []
    sampler = settling.RaySampler

    def recorded(photos: list[Photo], *rest: Any) -> RaySampler:
        spreads.append(bottom_spread(photos))
        return sampler(photos, *rest)

    class Told(Backdrop):
        def __init__(self, ground: Ground, photos: list[Photo]) -> None:
            spreads.append(bottom_spread(photos))
            super().__init__(ground, photos)

    def bottom_spread(photos: list[Photo]) -> float:
        means = [p.premultiplied_display[p.coverage > 0.99].mean() for p in photos]
        return float(np.log2(means).std())

    monkeypatch.setattr(settling, "RaySampler", recorded)
    monkeypatch.setattr(settling, "Backdrop", Told)
    config = GeometryConfig(
        level_cells=(32,), level_steps=(10,), rays=256, face_budget=800, without=("rivals",)
    )
    reconstruct(jittered, config, 0, "cpu", Mock())
    assert len(spreads) == 2
    assert max(spreads) < 0.06  # .18 as they were


def small_photo(display: NDArray[np.floating]) -> Photo:
    """A photograph that shows something everywhere."""
    height, width = display.shape[:2]
    camera = Camera(
        width=width, height=height, fx=1.0, fy=1.0, cx=0.0, cy=0.0, camera_to_world=np.eye(4)
    )
    return Photo(
        camera=camera,
        premultiplied_display=display.astype(np.float32),
        coverage=np.ones((height, width), np.float32),
    )


def test_noise_is_measured_whatever_the_shades_and_most_of_the_texture() -> None:
    across = np.linspace(0.0, 1.0, 120)
    shades = 0.5 + 0.3 * np.sin(4.0 * across[:, None] + 3.0 * across)[..., None] * [1.0, 0.5, -1.0]
    picture = shades.copy()
    picture[:, :60] += 0.15 * (-1.0) ** np.arange(60)[:, None]  # a half with stripes
    picture[:50, 60:] += 0.1 * np.random.default_rng(2).choice([-1.0, 1.0], (50, 60, 3))
    assert pixel_noise([small_photo(picture)], COVERED) < 0.002
    rng = np.random.default_rng(3)
    spoilt = [noisy(small_photo(shades), rng) for _ in range(2)]
    assert pixel_noise(spoilt, COVERED) == pytest.approx(NOISE, rel=0.05)
    assert pixel_noise([noisy(small_photo(picture), rng)], COVERED) == pytest.approx(NOISE, rel=0.3)


def test_noise_is_none_where_nothing_is_shown() -> None:
    empty = small_photo(np.zeros((20, 20, 3)))
    assert pixel_noise([replace(empty, coverage=np.zeros((20, 20), np.float32))], COVERED) == 0.0


def test_the_picture_of_the_ground_is_known_through_noise() -> None:
    def two_colours(points: NDArray[np.floating]) -> NDArray[np.floating]:
        return np.where(points[:, 2:] > -0.29, checker(points), soft(points))

    scene = trimesh.util.concatenate([disc(), drum(0.25, -0.3, 0.0)])
    capture = capture_of(scene, views=24, side=96, paint=two_colours)
    clean = [reduce_view(view, 96) for view in capture.views]
    rng = np.random.default_rng(4)
    shares = []
    for photos in (clean, [noisy(photo, rng) for photo in clean]):
        lattice, hull = carve(hull_of(photos), 48)
        plane = detect(photos, lattice, hull, torch.Generator().manual_seed(0))
        assert plane is not None
        backdrop = Backdrop(Ground(plane, photos, lattice, hull), photos)
        # what remains of the pixels that show ground where single ones are no proof
        masks = [binary_opening(mask, np.ones((3, 3), bool)) for mask in backdrop.shown()]
        shares.append(np.mean([mask.mean() for mask in masks]))
        assert backdrop.known[backdrop.ground.columns.inside].mean() > 0.8
    assert shares[1] > 0.95 * shares[0] > 0.2
