# SPDX-License-Identifier: Apache-2.0
"""Guessed masks against traced silhouettes; the parts against closed forms."""

from __future__ import annotations

import hashlib
from dataclasses import replace

import numpy as np
import pytest
from capture.masks import scene
from PIL import Image

from robir.capture.bounds import kept, shown, silhouette
from robir.capture.capture import Finding
from robir.capture.config import CaptureConfig
from robir.capture.frames import Distortion
from robir.capture.masks.guess import guess_masks, sharpened
from robir.capture.masks.matching import features, surface_points
from robir.capture.masks.region import find_region, focus, region_of_box
from robir.capture.masks.unmasked import _guess
from robir.capture.recognise import check_capture, read_capture, read_frames
from robir.capture.support import support_plane
from robir.capture.views import unheard
from robir.errors import CaptureError, ConfigError

SMALL = CaptureConfig(max_side=160)
BENT = Distortion(radial=(-0.12, 0.03, 0.0, 0.0))


@pytest.fixture(scope="module")
def shots() -> list[scene.Posed]:
    return scene.photographs(16)


@pytest.fixture(scope="module")
def points(shots) -> np.ndarray:
    large = scene.photographs(16, size=(400, 300))
    return surface_points(features(large))


def _files(folder) -> str:
    digest = hashlib.sha256()
    for path in sorted(folder.rglob("*.png")):
        digest.update(path.read_bytes())
    return digest.hexdigest()


def _found(findings: tuple[Finding, ...], code: str) -> Finding:
    return next(finding for finding in findings if finding.code == code)


def test_masks_of_a_capture_without_masks_are_the_silhouettes(tmp_path):
    shots = scene.photographs(12)
    source = scene.save_nerfstudio(tmp_path / "capture", shots)
    capture = read_capture(source, None, SMALL, guesses=tmp_path / "masks")
    scores = []
    for shot, view in zip(shots, capture.views, strict=True):
        drawn = np.array(Image.open(tmp_path / "masks" / "images" / f"{shot.name}.png"))
        assert drawn.shape == shot.truth.shape
        assert set(np.unique(drawn)) == {0, 255}
        assert np.array_equal(view.mask, drawn)
        scores.append(scene.overlap(drawn > 127, shot.truth))
    assert np.mean(scores) > 0.94
    assert min(scores) > 0.88
    about = _found(capture.findings, "guessed-masks")
    assert about.level == "note"
    assert str(tmp_path / "masks") in about.message
    # the ball's top is as high above the table as the sphere about ball and box reaches at least
    assert abs(np.linalg.norm(capture.bounds.centre - [0.2, 0.0, 0.5])) < 0.3
    again = read_capture(source, None, SMALL, guesses=tmp_path / "again")
    assert _files(tmp_path / "again") == _files(tmp_path / "masks")
    given = read_capture(source, tmp_path / "masks", SMALL)
    for one, two in zip(given.views, again.views, strict=True):
        assert np.array_equal(one.mask, two.mask)


def test_check_tells_what_would_be_guessed_and_writes_nothing(tmp_path):
    source = scene.save_nerfstudio(tmp_path / "capture", scene.photographs(8))
    capture, findings, _ = check_capture(source, None, SMALL)
    assert capture is not None
    assert "folder masks of the result" in _found(findings, "guessed-masks").message
    assert [path.name for path in tmp_path.iterdir()] == ["capture"]


def test_an_object_like_its_background_is_refused(tmp_path):
    shots = scene.photographs(12, has_camouflage=True)
    source = scene.save_nerfstudio(tmp_path / "capture", shots)
    with pytest.raises(CaptureError, match="no masks") as refusal:
        read_capture(source, None, SMALL, guesses=tmp_path / "masks")
    assert "could not be guessed" in str(refusal.value)
    assert "--masks DIR" in str(refusal.value)
    assert not (tmp_path / "masks").exists()


def test_masks_of_a_distorting_lens_lie_on_the_photographs_themselves(tmp_path):
    shots = scene.photographs(12, distortion=BENT)
    source = scene.save_nerfstudio(tmp_path / "capture", shots, BENT)
    read_capture(source, None, SMALL, guesses=tmp_path / "masks")
    scores = [
        scene.overlap(
            np.array(Image.open(tmp_path / "masks" / "images" / f"{shot.name}.png")) > 127,
            shot.truth,
        )
        for shot in shots
    ]
    assert np.mean(scores) > 0.92


def test_the_users_box_bounds_the_object(shots, points):
    box = (0.25, 0.0, 0.5, 1.6, 1.2, 1.1)
    region = region_of_box(box, [shot.camera for shot in shots], points)
    cells, half = region.cells(20)
    assert half == pytest.approx(0.8 / 20)
    assert (np.abs(cells - box[:3]) <= np.array(box[3:]) / 2 + 2 * half).all()
    with pytest.raises(ConfigError, match=r"capture\.box"):
        CaptureConfig(box=(0.0, 0.0, 0.0, 1.0, 1.0, 0.0))


def test_triangulated_points_lie_on_the_surfaces(points):
    ball = np.abs(np.linalg.norm(points - scene.BALL, axis=1) - scene.RADIUS)
    table = np.abs(points[:, 2])
    outside = np.maximum(scene.BOX_LOW - points, points - scene.BOX_HIGH).max(axis=1)
    nearest = np.minimum(np.minimum(ball, table), np.abs(outside))
    near = np.linalg.norm(points, axis=1) < 2.0
    assert near.sum() > 300
    assert np.median(nearest[near]) < 0.015


def test_the_cameras_aim_and_the_table_are_found(shots, points):
    views = [shot.camera for shot in shots]
    aim = focus(views)
    assert aim is not None
    assert aim[0] == pytest.approx([0.25, 0.1, 0.3], abs=1e-6)
    near = points[np.linalg.norm(points - aim[0], axis=1) < aim[1]]
    plane = support_plane(near, views, aim[1])
    assert plane is not None
    assert plane.normal @ [0, 0, 1] > np.cos(np.radians(2))
    assert abs(plane.offset) < 0.02
    region = find_region(views, points)
    assert region is not None
    assert np.linalg.norm(region.centre[:2] - [0.2, 0.0]) < 0.25


def test_a_side_of_the_object_is_no_table(points, tmp_path):
    shots = scene.photographs(12)
    source = scene.save_nerfstudio(tmp_path / "capture", shots)
    views = read_capture(source, None, SMALL).views
    table = find_region([view.camera for view in views], points)
    assert table is not None and len(table.table) > 50
    assert not guess_masks(views, table, print).is_own_table
    # a plain table has no points: the plane with most of them is then one through the object
    own = np.concatenate([scene.surface(shot.camera) for shot in shots])
    own = own[own[:, 2] > 0.25][::40]
    cut = find_region([view.camera for view in views], own)
    assert cut is not None and cut.plane is not None
    _, guess, _ = _guess(replace(read_frames(source), points=own), views, SMALL, unheard)
    assert guess is not None and guess.region.plane is None
    scores = [scene.overlap(m > 0.5, s.truth) for m, s in zip(guess.masks, shots, strict=True)]
    assert np.mean(scores) > 0.92


def test_what_stands_on_plain_legs_reaches_down_to_the_table():
    rng = np.random.default_rng(0)
    views = scene.cameras(16)
    table = np.column_stack([rng.uniform(-1.2, 1.2, (2000, 2)), rng.normal(0, 0.002, 2000)])
    body = rng.uniform((-0.25, -0.25, 0.6), (0.25, 0.25, 1.2), (1000, 3))
    region = find_region(views, np.concatenate([table, body]))
    assert region is not None and region.plane is not None
    shin, air = np.array([[-0.1, 0.0, 0.15]]), np.array([[0.9, 0.0, 0.15]])
    assert region.is_core(shin) and not region.is_core(air)
    assert (region.centre - region.half)[2] < 0


def test_parallel_cameras_have_no_common_focus(shots):
    pose = shots[0].camera.camera_to_world
    moved = []
    for shift in range(4):
        at = pose.copy()
        at[0, 3] += 0.3 * shift
        moved.append(replace(shots[0].camera, camera_to_world=at))
    assert focus(moved) is None


def test_the_volume_of_true_silhouettes_shows_them_again(shots, points):
    views = [shot.camera for shot in shots]
    region = find_region(views, points)
    assert region is not None
    cells, half = region.cells(64)
    truths = [shot.truth for shot in shots]
    half *= 0.6
    outlines = [silhouette(*pair) for pair in zip(views, truths, strict=True)]
    whole = kept(outlines, cells, half, 0)
    for camera, truth in zip(views, truths, strict=True):
        seen = shown(camera, cells[whole], half)
        assert seen[truth].mean() > 0.97
        assert scene.overlap(seen, truth) > 0.85
    # one photograph that shows next to nothing must not carve the object away
    speck = np.zeros_like(truths[0])
    speck[60, 80] = True
    doubted = kept([silhouette(views[0], speck), *outlines[1:]], cells, half, 1)
    assert doubted.sum() > 0.8 * whole.sum()


def test_outlines_follow_the_full_photograph():
    rows, columns = np.mgrid[:480, :640]
    truth = (rows - 250) ** 2 / 1.7 + (columns - 300) ** 2 < 120**2
    image = np.where(truth[..., None], [180, 60, 50], [90, 120, 150]).astype(np.uint8)
    small = np.array(Image.fromarray(truth).convert("L").resize((80, 60), Image.Resampling.BOX))
    mask = sharpened(image, small.astype(np.float32) / 255)
    assert scene.overlap(mask > 127, truth) > 0.99
