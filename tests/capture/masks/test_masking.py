# SPDX-License-Identifier: Apache-2.0
"""Guessed masks against traced silhouettes; the parts against closed forms."""

from __future__ import annotations

import hashlib
from dataclasses import replace

import numpy as np
import pytest
from capture.masks import scene
from PIL import Image

from robir.capture.capture import Finding
from robir.capture.check import check_capture
from robir.capture.config import CaptureConfig
from robir.capture.frames import Distortion
from robir.capture.masks.finish import sharpened
from robir.capture.masks.matching import features, triangulated
from robir.capture.masks.region import find_region, focus, region_of_box
from robir.capture.masks.soft_hull import Volume
from robir.capture.masks.table_disc import disc_about, disc_picture
from robir.capture.masks.walker import walk
from robir.capture.recognise import read_capture
from robir.capture.support import Plane, support_plane
from robir.errors import CaptureError, ConfigError

SMALL = CaptureConfig(max_side=160)
BENT = Distortion(radial=(-0.12, 0.03, 0.0, 0.0))


@pytest.fixture(scope="module")
def shots() -> list[scene.Posed]:
    return scene.photographs(16)


@pytest.fixture(scope="module")
def points(shots) -> np.ndarray:
    large = scene.photographs(16, size=(400, 300))
    return triangulated(features(large))


def _files(folder) -> str:
    digest = hashlib.sha256()
    for path in sorted(folder.rglob("*.png")):
        digest.update(path.read_bytes())
    return digest.hexdigest()


def _found(findings: tuple[Finding, ...], code: str) -> Finding:
    return next(finding for finding in findings if finding.code == code)


def test_masks_of_a_capture_without_masks_are_the_silhouettes(tmp_path, shots):
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


def test_check_tells_what_would_be_guessed_and_writes_nothing(tmp_path, shots):
    source = scene.save_nerfstudio(tmp_path / "capture", shots)
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


def test_a_kept_ground_is_a_disc_about_the_object(tmp_path, shots):
    source = scene.save_nerfstudio(tmp_path / "capture", shots)
    keep = replace(SMALL, ground="keep")
    capture, findings, _ = check_capture(source, None, keep)
    assert capture is not None
    assert "disc of the table is kept" in _found(findings, "kept-ground").message
    cut, *_ = check_capture(source, None, SMALL)
    assert cut is not None
    for with_ground, without in zip(capture.views, cut.views, strict=True):
        assert (with_ground.mask >= without.mask).all()
        assert with_ground.mask.sum() > 1.3 * without.mask.sum()


def test_the_users_box_bounds_the_object(shots, points):
    box = (0.25, 0.0, 0.5, 1.6, 1.2, 1.1)
    region = region_of_box(box, [shot.camera for shot in shots], points)
    cells, side = region.cells(20)
    assert side == pytest.approx(1.6 / 20)
    assert (np.abs(cells - box[:3]) <= np.array(box[3:]) / 2 + side).all()
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


def on_a_table(bottom: float, rng: np.random.Generator) -> np.ndarray:
    """Points of a table, and a clump of them from some height on to 1.2 above it."""
    table = np.column_stack([rng.uniform(-1.2, 1.2, (4000, 2)), rng.normal(0, 0.002, 4000)])
    clump = rng.uniform((-0.25, -0.25, bottom), (0.25, 0.25, 1.2), (2000, 3))
    return np.concatenate([table, clump])


def test_what_stands_on_plain_legs_reaches_down_to_the_table():
    rng = np.random.default_rng(0)
    views = scene.cameras(16)
    body = on_a_table(0.6, rng)
    legs = np.concatenate(
        [rng.uniform((x, -0.05, 0.1), (x + 0.1, 0.05, 0.6), (12, 3)) for x in (-0.2, 0.1)]
    )
    beside = rng.uniform((0.6, 0.6, 0.1), (0.7, 0.7, 0.6), (12, 3))
    region = find_region(views, np.concatenate([body, legs, beside]))
    assert region is not None and region.plane is not None
    kept = {tuple(point) for point in region.points.round(6)}
    assert all(tuple(point) in kept for point in legs.round(6)), "points of the legs are missing"
    assert not any(tuple(point) in kept for point in beside.round(6))
    shin, air = np.array([[-0.1, 0.0, 0.15]]), np.array([[0.9, 0.0, 0.15]])
    assert region.belief(shin) > 0.7 > 0.3 > region.belief(air)
    box = (region.centre - region.half)[2]
    assert box == pytest.approx(region.plane.offset, abs=0.02)
    # the legs make the box no wider
    alone = find_region(views, body)
    assert alone is not None
    np.testing.assert_allclose(region.half[:2], alone.half[:2], rtol=0.05)
    # what nearly touches the table stands there itself
    standing = find_region(views, np.concatenate([on_a_table(0.1, rng), legs]))
    assert standing is not None
    assert standing.belief(np.array([[0.0, 0.0, 0.05]])) > 0.5


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
    volume = Volume(region, views)
    truths = [shot.truth.astype(np.float32) for shot in shots]
    volume.carve(truths, 0.05)
    for k, truth in enumerate(truths):
        shown = volume.picture(k)
        assert (shown[truth > 0.5] > 0.4).mean() > 0.97
        assert scene.overlap(shown > 0.4, truth > 0.5) > 0.85
    # one photograph that shows nothing must not carve the object away
    whole = (volume.belief > 0.5).sum()
    volume.carve([np.zeros_like(truths[0]), *truths[1:]], 0.1)
    assert (volume.belief > 0.5).sum() > 0.8 * whole


def test_belief_walks_up_to_the_edge_and_no_farther():
    lab = np.zeros((40, 60, 3), np.float32)
    lab[:, 30:] = 60.0
    belief = np.full((40, 60), 0.5, np.float32)
    belief[20, 5], belief[20, 55] = 1.0, 0.0
    mask = walk(lab, belief, steps=400) > 0.5
    assert mask[:, :30].all()
    assert not mask[:, 30:].any()


def test_the_walker_solves_its_equations():
    generator = np.random.default_rng(3)
    lab = generator.uniform(0, 20, (9, 11, 3)).astype(np.float32)
    belief = generator.uniform(0, 1, (9, 11)).astype(np.float32)
    x = walk(lab, belief, steps=500).astype(np.float64)
    squares = [np.square(np.diff(lab, axis=a)).sum(axis=2) for a in (0, 1)]
    width = 2 * sum(s.sum() for s in squares) / sum(s.size for s in squares)
    system = np.diag(0.05 * (np.abs(2 * belief.ravel() - 1) + 1e-3)).astype(np.float64)
    right = np.diag(system) * belief.ravel()
    number = np.arange(99).reshape(9, 11)
    for square, one, two in (
        (squares[0], number[:-1], number[1:]),
        (squares[1], number[:, :-1], number[:, 1:]),
    ):
        for w, i, j in zip(
            (np.exp(-square / width) + 0.002).ravel(), one.ravel(), two.ravel(), strict=True
        ):
            system[[i, j], [i, j]] += w
            system[[i, j], [j, i]] -= w
    assert x.ravel() == pytest.approx(np.linalg.solve(system, right), abs=5e-3)


def test_outlines_follow_the_full_photograph():
    rows, columns = np.mgrid[:480, :640]
    truth = (rows - 250) ** 2 / 1.7 + (columns - 300) ** 2 < 120**2
    image = np.where(truth[..., None], [180, 60, 50], [90, 120, 150]).astype(np.uint8)
    small = np.array(Image.fromarray(truth).convert("L").resize((80, 60), Image.Resampling.BOX))
    mask = sharpened(image, small.astype(np.float32) / 255)
    assert scene.overlap(mask > 127, truth) > 0.99


def test_the_disc_of_ground_is_round_and_flat(shots):
    plane = Plane(normal=np.array([0.0, 0.6, 0.8]), offset=0.1, tolerance=0.01)
    axes = np.array([[1.0, 0.0, 0.0], [0.0, 0.8, -0.6]])
    corners = [[x, y] for x in (-0.5, 0.9) for y in (-0.5, 0.5)]
    volume = np.array(corners) @ axes + 0.5 * plane.normal
    rim = disc_about(volume, plane)
    assert np.ptp(plane.height(rim)) < 1e-9
    radius = 1.5 * np.hypot(0.7, 0.5)
    distance = np.linalg.norm(rim - rim.mean(axis=0), axis=1)
    assert distance == pytest.approx(np.full(len(rim), radius), rel=1e-6)
    cover = disc_picture(rim, shots[1].camera)
    assert 0.05 < cover.mean() < 0.9
