# SPDX-License-Identifier: Apache-2.0
"""What `robir check` says of blur, exposure and coverage."""

from __future__ import annotations

import json
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
from capture import writers
from capture.lit_scene import BOUNDS, exposed, photographs
from capture.scene import Shot, cameras, look_at
from PIL import Image
from scipy import ndimage

from robir.capture.capture import Bounds, Finding, View
from robir.capture.checks.coverage import check_coverage, check_sharpness, upwards
from robir.capture.checks.findings import check_place
from robir.capture.checks.photographs import (
    check_brightness,
    check_settings,
    exposure_offsets,
    sight,
)
from robir.capture.config import CaptureConfig
from robir.capture.recognise import check_capture


@pytest.fixture(scope="module")
def sunlit() -> list[View]:
    return photographs()


def the(findings: list[Finding]) -> Finding:
    """The only finding, fit for JSON."""
    (finding,) = findings
    assert json.loads(json.dumps(asdict(finding)))["code"] == finding.code
    return finding


def blurred(view: View, size: float) -> View:
    image = ndimage.gaussian_filter(view.image_display.astype(np.float32), (size, size, 0))
    return replace(view, image_display=np.rint(image).astype(np.uint8))


def test_a_good_capture_is_only_noted(sunlit):
    assert check_sharpness(sunlit, BOUNDS) == []
    assert check_brightness(sunlit, BOUNDS) == []
    assert the(check_coverage(sunlit, BOUNDS)).level == "note"


@pytest.mark.parametrize("size", [2.0, 3.0])
def test_blurred_photographs_are_named(size, sunlit):
    views = list(sunlit)
    views[4], views[17] = blurred(views[4], size), blurred(views[17], size + 1)
    finding = the(check_sharpness(views, BOUNDS))
    assert (finding.code, finding.level) == ("blurred", "warning")
    assert set(finding.files) == {"v17", "v04"}
    first, second = finding.numbers["sharpness"]
    assert first <= second < 0.76
    assert "shutter" in finding.cure


def test_motion_in_one_direction_is_blur(sunlit):
    views = list(sunlit)
    image = ndimage.uniform_filter1d(views[9].image_display.astype(np.float32), 9, axis=1)
    views[9] = replace(views[9], image_display=image.astype(np.uint8))
    assert the(check_sharpness(views, BOUNDS)).files == ("v09",)


def test_a_plain_side_is_not_blurred(sunlit):
    """A view that shows no texture at all says nothing about sharpness."""
    views = list(sunlit)
    ramp = np.linspace(60, 90, 80)[None, :, None]
    plain = np.broadcast_to(ramp, (80, 80, 3)).astype(np.uint8)
    views[9] = replace(views[9], image_display=plain)
    assert check_sharpness(views, BOUNDS) == []


def test_glitter_on_other_sides_is_no_blur(sunlit):
    """Noise in the neighbours makes a sharp photograph less sharp than they are, not blurred."""
    noise = np.random.default_rng(0)
    views = []
    for i, view in enumerate(sunlit):
        grain = noise.integers(-60, 61, view.image_display.shape) * (i != 9)
        image = np.clip(view.image_display.astype(int) + grain, 0, 255).astype(np.uint8)
        views.append(replace(view, image_display=image))
    assert check_sharpness(views, BOUNDS) == []


def test_changed_exposure_is_measured(sunlit):
    steps = np.random.default_rng(4).uniform(-0.5, 0.5, len(sunlit))
    steps[7] = -1.2
    views = [exposed(view, step) for view, step in zip(sunlit, steps, strict=True)]
    offsets = exposure_offsets(sight(views, BOUNDS))
    assert np.abs(offsets - (steps - np.median(steps))).mean() < 0.1
    assert np.corrcoef(offsets, steps)[0, 1] > 0.97
    finding = the(check_brightness(views, BOUNDS))
    assert (finding.code, finding.level) == ("brightness-changes", "warning")
    assert finding.files[0] == "v07"
    assert finding.numbers["spread_steps"] == pytest.approx(steps.std(), rel=0.25)
    assert "manual" in finding.cure


def test_coverage_names_the_widest_gap():
    """Cameras of a half dome: the far side is missing."""
    poses = [
        look_at(BOUNDS.centre + 3 * direction(azimuth, elevation), BOUNDS.centre)
        for azimuth in range(-90, 91, 20)
        for elevation in (5, 35, 60)
    ]
    views = [posed(pose, i) for i, pose in enumerate(poses)]
    assert upwards(views) @ [0, 0, 1] > 0.999
    finding = the(check_coverage(views, BOUNDS))
    assert (finding.code, finding.level) == ("coverage-gap", "warning")
    numbers = finding.numbers
    # From the poles of the half circle, the opposite side is 90 degrees away.
    gap = np.array(numbers["gap_direction"])
    assert gap @ direction(180, 0) > 0.9
    assert 80 < numbers["gap_degrees"] <= 100
    assert 0.4 < numbers["seen_share"] < 0.75
    missing = np.array(numbers["missing"])
    assert (missing @ direction(180, 20) > 0).all()
    assert "height of the object" in finding.message
    assert finding.files[0] in {view.name for view in views}


def test_coverage_of_a_ring_lacks_the_top():
    poses = [
        look_at(BOUNDS.centre + 3 * direction(azimuth, 10), BOUNDS.centre)
        for azimuth in range(0, 360, 12)
    ]
    finding = the(check_coverage([posed(pose, i) for i, pose in enumerate(poses)], BOUNDS))
    assert finding.code == "coverage-gap"
    assert "from above" in finding.message
    assert finding.numbers["gap_degrees"] == pytest.approx(80, abs=4)


def direction(azimuth: float, elevation: float) -> np.ndarray:
    a, e = np.radians([azimuth, elevation])
    return np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])


def posed(pose: np.ndarray, number: int) -> View:
    camera = replace(cameras(1)[0], camera_to_world=pose)
    blank = np.zeros((2, 2), np.uint8)
    return View(
        name=f"{number}",
        image_display=np.zeros((2, 2, 3), np.uint8),
        mask=blank,
        camera=camera,
        split="train",
    )


def jpeg(path: Path, time: float, speed: int = 100, aperture: float = 8.0, flash: int = 16) -> Path:
    exif = Image.Exif()
    exif.get_ifd(0x8769).update({33434: time, 34855: speed, 33437: aperture, 37385: flash})
    Image.new("RGB", (8, 8), "gray").save(path, exif=exif)
    return path


def test_exposures_the_camera_wrote(tmp_path):
    same = [jpeg(tmp_path / f"{i}.jpg", 1 / 100) for i in range(4)]
    # Twice the time at half the sensitivity is the same exposure.
    same.append(jpeg(tmp_path / "even.jpg", 1 / 50, speed=50))
    plain = tmp_path / "none.png"
    Image.new("RGB", (8, 8)).save(plain)
    broken = tmp_path / "broken.jpg"
    broken.write_bytes(b"\xff\xd8nothing")
    assert check_settings([*same, plain, broken, tmp_path / "absent.jpg"]) == []
    changed = [*same, jpeg(tmp_path / "long.jpg", 1 / 25)]
    finding = the(check_settings(changed))
    assert (finding.code, finding.level) == ("exposure-settings", "warning")
    assert finding.files == ("long.jpg",)
    assert finding.numbers["spread_steps"] == pytest.approx(2.0, abs=0.01)
    wide = the(check_settings([*same, jpeg(tmp_path / "wide.jpg", 1 / 100, aperture=5.6)]))
    assert wide.numbers["spread_steps"] == pytest.approx(1.03, abs=0.01)


def test_a_flash_that_fired(tmp_path):
    paths = [jpeg(tmp_path / f"{i}.jpg", 0.01, flash=(16, 25)[i % 2]) for i in range(4)]
    finding = the(check_settings(paths))
    assert finding.code == "flash-fired"
    assert finding.files == ("1.jpg", "3.jpg")
    assert "2 of 4" in finding.message


def test_far_from_the_origin(sunlit):
    far = Bounds(centre=np.array([4e6, 1e5, 0.0]), radius=0.5, origin="hand")
    assert "far-from-origin" in {finding.code for finding in check_place(sunlit, far)}
    assert "far-from-origin" not in {finding.code for finding in check_place(sunlit, BOUNDS)}


def test_checks_are_part_of_reading_a_capture(tmp_path):
    views = photographs(24)
    views[5] = blurred(views[5], 3.0)
    shots = [Shot(v.camera, np.dstack([v.image_display, v.mask])) for v in views]
    writers.nerf_synthetic(tmp_path, shots)
    _, findings, _ = check_capture(tmp_path, None, CaptureConfig())
    found = {finding.code: finding for finding in findings}
    assert found["blurred"].files == ("r_5",)
    assert found["coverage"].numbers["seen_share"] > 0.9
