# SPDX-License-Identifier: Apache-2.0
"""What is drawn for a capture of photographs, and what a camera makes of radiance."""

from dataclasses import replace

import numpy as np
import pytest

from blender_scenes.photographs import stock
from blender_scenes.photographs.developing import (
    Shot,
    display,
    noise_deviation,
    vignetting,
)
from blender_scenes.photographs.posing import erroneous, placed, walked_poses
from blender_scenes.photographs.recipe import Developing, Frame, PhotoRecipe
from blender_scenes.photographs.response import is_monotone
from blender_scenes.population import photo_ranges as table
from blender_scenes.population.draw import Sources
from blender_scenes.population.photo_draw import draw_photographs
from blender_scenes.view_transform import measured_response

MANY = 400
FRAME = Frame(300, 200, 60.0)
CENTRE, RADIUS = np.array([0.1, -0.2, 0.4]), 0.6


@pytest.fixture(scope="module")
def sources(tmp_path_factory: pytest.TempPathFactory) -> Sources:
    folder = tmp_path_factory.mktemp("files")
    files = [folder / name for name in ("cow.obj", "car.gltf", "noon.hdr", "dusk.exr")]
    for file in files:
        file.write_text(file.name)
    return Sources(tuple(files[:2]), tuple(files[2:]))


@pytest.fixture(scope="module")
def drawn(sources: Sources) -> list[PhotoRecipe]:
    return [draw_photographs(seed, sources) for seed in range(MANY)]


def test_a_seed_says_everything(sources: Sources, drawn: list[PhotoRecipe]) -> None:
    assert [draw_photographs(seed, sources) for seed in range(20)] == drawn[:20]
    assert len({stock.fingerprint(one) for one in drawn[:8]}) == 8


def test_everything_lies_in_its_range(drawn: list[PhotoRecipe]) -> None:
    for one in drawn:
        frame, developing = one.frame, one.developing
        assert 400 <= max(frame.width, frame.height) <= 1000
        assert 20 <= one.walk.photographs <= 70
        cost = frame.width * frame.height * one.walk.photographs * one.samples
        assert cost <= 1.05 * table.PIXEL_SAMPLES
        assert (one.handover.poses == "none") == (one.handover.layout == "photographs")
        assert 85 <= developing.quality <= 97
        assert 0.0 <= developing.exposure_jitter <= 0.4
        assert np.abs(np.array(developing.white_balance) - 1.0).max() <= 0.15
        assert 50 <= developing.iso <= 1600
        assert is_monotone(developing.response)
        assert 1.0 <= abs(one.handover.growth) <= 2.0
        for finish in (one.thing.body, one.thing.trim, one.table.finish):
            assert all(0.02 <= c <= 0.9 for colour in finish.colours for c in colour)


def camera(**changes: object) -> Developing:
    plain = Developing(
        response=(0.0, 0.0, 0.0), iso=400.0, full_well=8000.0, read_noise=4.0, quality=90,
        brightness=0.0, exposure_jitter=0.0, white_balance=(1.0, 1.0, 1.0), balance_jitter=0.0,
        vignetting=0.0, has_exif=False, seed=3,
    )  # fmt: skip
    return replace(plain, **changes)


def test_vignetting_is_the_fourth_power_of_the_cosine_of_the_field_angle() -> None:
    factor = vignetting(FRAME, 1.0)
    ray = np.array([0.5 - 150.0, 0.5 - 100.0, FRAME.focal])
    assert factor[0, 0] == pytest.approx((FRAME.focal / np.linalg.norm(ray)) ** 4)
    assert factor[100, 150] == pytest.approx(1.0, abs=1e-4)
    np.testing.assert_allclose(1.0 - vignetting(FRAME, 0.5), 0.5 * (1.0 - factor))


def test_noise_is_of_shots_and_of_reading() -> None:
    """2000 electrons make white at ISO 400: at a quarter of white 500 come, plus 16 of reading."""
    assert noise_deviation(np.array(0.25), camera()) == pytest.approx(np.sqrt(516.0) / 2000.0)
    flat = Frame(400, 300, 60.0)
    grey = np.full((300, 400, 3), 0.25)
    shown = display(grey, Shot(0.0, (1.0, 1.0, 1.0)), camera(), flat, 5)
    clean = display(grey, Shot(0.0, (1.0, 1.0, 1.0)), camera(), flat, None)
    slope = (measured_response(np.array(0.251)) - measured_response(np.array(0.249))) / 0.002
    assert shown.std() == pytest.approx(np.sqrt(516.0) / 2000.0 * slope, rel=0.02)
    assert shown.mean() == pytest.approx(clean.mean(), abs=2e-3)


def test_photographs_are_taken_round_the_thing_and_look_at_it(drawn: list[PhotoRecipe]) -> None:
    for one in drawn[:60]:
        poses = walked_poses(one.walk, one.frame, CENTRE, RADIUS)
        assert len(poses) == one.walk.photographs
        away = poses[:, :3, 3] - CENTRE
        assert poses[:, 2, 3].min() > 0.0
        ahead = -poses[:, :3, 2]
        cosine = -(ahead * away).sum(axis=1) / np.linalg.norm(away, axis=1)
        assert cosine.min() > np.cos(np.radians(15.0))
        np.testing.assert_allclose(np.linalg.det(poses[:, :3, :3]), 1.0)


def pixels(poses: np.ndarray, frame: Frame, focal: float, points: np.ndarray) -> np.ndarray:
    """(V, N, 2) where points are seen."""
    local = np.einsum("vij,vnj->vni", poses[:, :3, :3].transpose(0, 2, 1),
                      points - poses[:, None, :3, 3])  # fmt: skip
    return focal * local[..., :2] / -local[..., 2:]


def test_wrong_poses_move_the_thing_by_under_a_pixel_or_so(drawn: list[PhotoRecipe]) -> None:
    rng = np.random.default_rng(0)
    points = CENTRE + RADIUS * rng.normal(size=(50, 3)) / 2.0
    found = []
    for one in drawn[:60]:
        poses = walked_poses(one.walk, one.frame, CENTRE, RADIUS)
        errors = one.handover.errors
        wrong = erroneous(poses, one.frame, CENTRE, errors, one.handover.seed)
        true = pixels(poses, one.frame, one.frame.focal, points)
        seen = pixels(wrong, one.frame, one.frame.focal * (1.0 + errors.focal), points)
        scale = max(one.frame.width, one.frame.height) / 1000.0
        found.append(np.sqrt(((seen - true) ** 2).sum(axis=-1).mean()) / scale)
        moved, at = placed(wrong, points, 7, is_upright=False)
        again = pixels(moved, one.frame, one.frame.focal * (1.0 + errors.focal), at)
        np.testing.assert_allclose(again, seen, atol=1e-6)
    assert 0.3 < np.median(found) < 1.0
    assert max(found) < 2.0
