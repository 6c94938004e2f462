# SPDX-License-Identifier: Apache-2.0
"""Cameras adjusted by points that stand out, against known places and traced scenes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from capture.masks import scene
from scipy.spatial.transform import Rotation

from robir.capture.camera import Camera
from robir.capture.capture import Bounds, Capture, View
from robir.capture.masks.matching import Tracks, errors, triangulated
from robir.capture.poses.adjust import adjust, aligned, lead, moved_cameras, with_adjusted_cameras
from robir.maths.similarity import Similarity

pytestmark = pytest.mark.pycolmap

VIEWS, POINTS = 12, 80
COUNT = 24  # traced photographs


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(5)


@pytest.fixture
def cameras() -> list[Camera]:
    return scene.cameras(VIEWS, (800, 600))


def tracks_of(cameras: Sequence[Camera], points: np.ndarray, seen: np.ndarray) -> Tracks:
    """Every point (N, 3) as the cameras see it that `seen` (V, N) allows."""
    view, point = np.nonzero(seen)
    pixels = np.concatenate(
        [c.project(points[own])[0] for c, own in zip(cameras, seen, strict=True)]
    )
    return Tracks(view=view, point=point, pixels=pixels)


def shaken(cameras: Sequence[Camera], rng, turn: float = 0.005) -> list[Camera]:
    """Turned by a few tenths of a degree and moved by a hundredth."""
    found = []
    for camera in cameras:
        pose = camera.camera_to_world.copy()
        pose[:3, :3] @= Rotation.from_rotvec(turn * rng.standard_normal(3)).as_matrix()
        pose[:3, 3] += 0.01 * rng.standard_normal(3)
        found.append(replace(camera, camera_to_world=pose))
    return found


def test_points_are_triangulated_from_their_rays(cameras, rng):
    points = 0.3 * rng.standard_normal((POINTS, 3))
    tracks = tracks_of(cameras, points, rng.random((VIEWS, POINTS)) < 2 / 3)
    found = triangulated(cameras, tracks)
    np.testing.assert_allclose(found, points, atol=1e-6)
    assert errors(cameras, tracks, found).max() < 1e-4


def test_shaken_cameras_come_back(cameras, rng):
    points = 0.4 * rng.standard_normal((2 * POINTS, 3))
    tracks = tracks_of(cameras, points, rng.random((VIEWS, 2 * POINTS)) < 2 / 3)
    # a twentieth of what was found stands for another point
    wrong = rng.random(len(tracks.view)) < 0.05
    tracks.pixels[wrong] += 10 * rng.standard_normal((int(wrong.sum()), 2))
    start = [replace(c, fx=1.02 * c.fx, fy=1.02 * c.fy) for c in shaken(cameras, rng)]
    found = aligned(moved_cameras(start, tracks, zooms=True), cameras)
    for one, other in zip(found, cameras, strict=True):
        np.testing.assert_allclose(one.position, other.position, atol=3e-3)
        assert one.fx == pytest.approx(other.fx, rel=3e-3)
        turn = one.camera_to_world[:3, :3] @ other.camera_to_world[:3, :3].T
        assert Rotation.from_matrix(turn).magnitude() < 1.5e-3
    kept = moved_cameras(start, tracks, zooms=False)
    assert [c.fx for c in kept] == pytest.approx([c.fx for c in start])


def test_a_moved_frame_is_moved_back(cameras, rng):
    turn = Rotation.random(random_state=3).as_matrix()
    place = Similarity(turn=turn, scale=1.7, shift=rng.standard_normal(3))
    back = aligned([camera.moved(place) for camera in cameras], cameras)
    for one, other in zip(back, cameras, strict=True):
        np.testing.assert_allclose(one.camera_to_world, other.camera_to_world, atol=1e-9)


def test_the_lead_is_students(rng):
    from scipy.stats import ttest_1samp

    view = np.repeat(np.arange(20), 30)
    gain = 0.1 + 0.3 * rng.standard_normal(20)
    before = rng.random(600)
    after = before - gain[view]
    assert lead(view, before, after) == pytest.approx(ttest_1samp(gain, 0.0).statistic)


@pytest.fixture(scope="module")
def capture() -> Capture:
    """Traced photographs with true masks."""
    shots = scene.photographs(COUNT, size=(400, 300))
    views = tuple(
        View(
            name=shot.name,
            image_display=shot.image_display,
            mask=np.where(shot.truth, 255, 0).astype(np.uint8),
            camera=shot.camera,
            split="train",
        )
        for shot in shots
    )
    bounds = Bounds(centre=np.array([0.25, 0.0, 0.45]), radius=0.9, origin="made")
    return Capture(source=Path("made"), format="made", views=views, bounds=bounds)


def test_exact_cameras_stay_to_the_last_bit(capture):
    assert with_adjusted_cameras(capture) is capture


def test_wrong_cameras_are_moved_and_the_user_is_told(capture):
    rng = np.random.default_rng(1)
    wrong = shaken([view.camera for view in capture.views], rng, turn=0.003)
    views = [replace(v, camera=c) for v, c in zip(capture.views, wrong, strict=True)]
    spoilt = replace(capture, views=tuple(views))
    mended = with_adjusted_cameras(spoilt)
    finding = next(f for f in mended.findings if f.code == "cameras-off")
    assert "adjust_cameras=false" in finding.cure
    points = np.random.default_rng(0).uniform([-0.4, -0.4, 0.05], [0.8, 0.4, 0.9], (300, 3))

    def off(these: Capture) -> float:
        """Pixels by which points that true cameras show miss each other with these."""
        own, true = ([view.camera for view in one.views] for one in (these, capture))
        tracks = tracks_of(true, points, np.ones((COUNT, 300), bool))
        return float(errors(own, tracks, triangulated(own, tracks)).mean())

    assert off(mended) < 0.5 * off(spoilt)


def test_photographs_without_anything_that_stands_out_keep_their_cameras(capture):
    plain = tuple(
        replace(view, image_display=np.full_like(view.image_display, 90)) for view in capture.views
    )
    assert adjust(plain) is None
