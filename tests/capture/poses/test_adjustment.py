# SPDX-License-Identifier: Apache-2.0
"""Cameras adjusted by points that stand out, against differences, closed forms, traced scenes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from capture.masks import scene
from scipy.spatial.transform import Rotation

from robir.capture.capture import Bounds, Capture, View
from robir.capture.poses.adjustment import adjust, lead, with_adjusted_cameras
from robir.capture.poses.bundle import Bundle, Tracks, _derivatives, adjusted

VIEWS, POINTS = 12, 80

COUNT = 32
"""Traced photographs."""


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(5)


@pytest.fixture
def bundle() -> Bundle:
    return Bundle.of(scene.cameras(VIEWS, (800, 600)))


def tracks_of(bundle: Bundle, points: np.ndarray, rng, noise: float = 0.0) -> Tracks:
    """Every point as two thirds of the cameras see it."""
    view, point = (part.ravel() for part in np.meshgrid(np.arange(VIEWS), np.arange(len(points))))
    kept = rng.random(len(view)) < 2 / 3
    view, point = view[kept], point[kept]
    blank = Tracks(view=view, point=point, pixels=np.zeros((len(view), 2)))
    pixels = bundle.offsets(blank, points) + noise * rng.standard_normal((len(view), 2))
    return replace(blank, pixels=pixels)


def shaken(bundle: Bundle, rng) -> Bundle:
    """Turned by a few tenths of a degree, moved by a hundredth, zoomed by 2 %."""
    step = np.concatenate(
        [
            np.hstack(
                [0.005 * rng.standard_normal((VIEWS, 3)), 0.01 * rng.standard_normal((VIEWS, 3))]
            ).ravel(),
            [0.02],
        ]
    )
    return bundle.moved(step)


def test_points_fall_where_the_camera_projects_them(bundle, rng):
    points = 0.3 * rng.standard_normal((POINTS, 3))
    tracks = tracks_of(bundle, points, rng)
    for number, camera in enumerate(scene.cameras(VIEWS, (800, 600))):
        own = tracks.view == number
        np.testing.assert_allclose(
            tracks.pixels[own], camera.project(points[tracks.point[own]])[0], atol=1e-9
        )


def test_derivatives_are_those_of_differences(bundle, rng):
    points = 0.3 * rng.standard_normal((POINTS, 3))
    tracks = tracks_of(bundle, points, rng)
    by_camera, by_point = _derivatives(bundle, tracks, points)
    size = 1e-6
    for column in range(7):
        step = np.zeros((VIEWS, 7))
        step[:, column] = size
        flat = np.append(step[:, :6].ravel(), size if column == 6 else 0.0)
        change = bundle.moved(flat).offsets(tracks, points) - bundle.offsets(tracks, points)
        np.testing.assert_allclose(change / size, by_camera[:, :, column], atol=2e-2, rtol=1e-4)
    for axis in range(3):
        change = bundle.offsets(tracks, points + size * np.eye(3)[axis])
        change = change - bundle.offsets(tracks, points)
        np.testing.assert_allclose(change / size, by_point[:, :, axis], atol=2e-2, rtol=1e-4)


def test_points_are_triangulated_from_their_rays(bundle, rng):
    points = 0.3 * rng.standard_normal((POINTS, 3))
    found = bundle.triangulated(tracks_of(bundle, points, rng))
    np.testing.assert_allclose(found, points, atol=1e-6)


def test_shaken_cameras_come_back(bundle, rng):
    points = 0.4 * rng.standard_normal((POINTS, 3))
    tracks = tracks_of(bundle, points, rng)
    # a tenth of what was found stands for another point
    wrong = rng.random(len(tracks.view)) < 0.1
    tracks.pixels[wrong] += 40 * rng.standard_normal((int(wrong.sum()), 2))
    start = replace(shaken(bundle, rng), zoom=0.0)  # as if it had been given so
    assert np.median(start.errors(tracks, start.triangulated(tracks))) > 1.0
    found, _ = adjusted(start, tracks, start.triangulated(tracks), 60, moves_cameras=True)
    found = found.aligned(bundle)
    np.testing.assert_allclose(found.centres, bundle.centres, atol=2e-3)
    np.testing.assert_allclose(found.focal, bundle.focal, rtol=2e-3)
    turn = Rotation.from_matrix(found.rotations @ bundle.rotations.transpose(0, 2, 1))
    assert turn.magnitude().max() < 1e-3


def test_points_that_do_not_tell_a_focal_length_leave_it_as_given(rng):
    """Of a flat, small thing from one height, focal length and distance are all but the same."""
    cameras = scene.cameras(VIEWS, (800, 600))
    far = [
        replace(c, fx=8 * c.fx, fy=8 * c.fy, camera_to_world=_further(c.camera_to_world, 8.0))
        for c in cameras
    ]
    bundle = Bundle.of(far)
    points = 0.1 * rng.standard_normal((40, 3)) * [1.0, 1.0, 0.05]
    tracks = tracks_of(bundle, points, rng, noise=0.5)
    found, _ = adjusted(bundle, tracks, bundle.triangulated(tracks), 60, moves_cameras=True)
    assert found.zoom == pytest.approx(np.log(found.focal[0, 0] / bundle.focal[0, 0]), abs=1e-9)
    assert abs(found.zoom) < 0.03


def _further(pose: np.ndarray, factor: float) -> np.ndarray:
    moved = pose.copy()
    moved[:3, 3] *= factor
    return moved


def test_a_moved_frame_is_moved_back(bundle, rng):
    turn, shift = Rotation.random(random_state=3).as_matrix(), rng.standard_normal(3)
    there = replace(
        bundle,
        rotations=bundle.rotations @ turn.T,
        centres=1.7 * bundle.centres @ turn.T + shift,
    )
    back = there.aligned(bundle)
    np.testing.assert_allclose(back.centres, bundle.centres, atol=1e-9)
    np.testing.assert_allclose(back.rotations, bundle.rotations, atol=1e-9)


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
    wrong = []
    for view in capture.views:
        pose = view.camera.camera_to_world.copy()
        turn = 0.003 * rng.standard_normal(3)
        pose[:3, :3] = pose[:3, :3] @ Rotation.from_rotvec(turn).as_matrix()
        pose[:3, 3] += 0.01 * rng.standard_normal(3)
        wrong.append(replace(view, camera=replace(view.camera, camera_to_world=pose)))
    spoilt = replace(capture, views=tuple(wrong))
    mended = with_adjusted_cameras(spoilt)
    finding = next(f for f in mended.findings if f.code == "cameras-off")
    assert "adjust_cameras=false" in finding.cure
    points = np.random.default_rng(0).uniform([-0.4, -0.4, 0.05], [0.8, 0.4, 0.9], (300, 3))

    def off(these: Capture) -> float:
        """Pixels by which points that true cameras show miss each other with these."""
        own, true = (Bundle.of([view.camera for view in one.views]) for one in (these, capture))
        view, point = (p.ravel() for p in np.meshgrid(np.arange(COUNT), np.arange(300)))
        tracks = Tracks(view=view, point=point, pixels=np.zeros((len(view), 2)))
        tracks = replace(tracks, pixels=true.offsets(tracks, points))
        start = own.triangulated(tracks)
        met = adjusted(own, tracks, start, 20, moves_cameras=False)[1]
        return float(own.errors(tracks, met).mean())

    assert off(mended) < 0.5 * off(spoilt)  # .43 on one processor, less on another


def test_photographs_without_anything_that_stands_out_keep_their_cameras(capture):
    plain = tuple(
        replace(view, image_display=np.full_like(view.image_display, 90)) for view in capture.views
    )
    assert adjust(plain) is None
