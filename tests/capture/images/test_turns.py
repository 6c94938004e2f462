# SPDX-License-Identifier: Apache-2.0
"""EXIF turns where poses and masks may be for photographs as stored or as turned."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from capture import writers
from capture.images.profiles import REPORTS
from capture.scene import Shot, cameras, shoot
from PIL import Image, ImageOps

from robir.capture.config import CaptureConfig
from robir.capture.recognise import read_capture
from robir.capture.refusal import CaptureRefusedError


@pytest.fixture(scope="module")
def marked() -> list[Shot]:
    """The test scene with a pattern that no turn leaves as it is."""
    return [shoot(camera, samples=2) for camera in cameras(12, size=(64, 64))]


@pytest.fixture(scope="module")
def truth(marked, tmp_path_factory) -> tuple:
    """Views of the scene as no EXIF data turn it."""
    return views_of(writers.nerfstudio(tmp_path_factory.mktemp("truth") / "a", marked))


def turned(path: Path, turn: int) -> None:
    """Store a picture so that EXIF data has to turn it, and say so."""
    exif = Image.Exif()
    exif[0x0112] = {6: 8, 8: 6}.get(turn, turn)
    with Image.open(path) as picture:
        picture.load()
        picture.info["exif"] = exif.tobytes()
        stored = ImageOps.exif_transpose(Image.open(_saved(path, picture, exif)))
    exif = Image.Exif()
    exif[0x0112] = turn
    stored.save(path, exif=exif)


def _saved(path: Path, picture: Image.Image, exif: Image.Exif) -> Path:
    picture.save(path, exif=exif)
    return path


def marked_only(path: Path, turn: int) -> None:
    """Say that EXIF data has to turn a picture, pixels untouched."""
    exif = Image.Exif()
    exif[0x0112] = turn
    with Image.open(path) as picture:
        picture.load()
    picture.save(path, exif=exif)


def views_of(root: Path) -> tuple:
    return read_capture(root, None, CaptureConfig(adjust_cameras=False)).views


def assert_same(views, truth) -> None:
    for view, other in zip(views, truth, strict=True):
        assert np.array_equal(view.mask, other.mask)
        assert np.array_equal(view.image_display, other.image_display)


@pytest.mark.parametrize("turn", [2, 5, 8])
def test_poses_and_masks_upright(marked, truth, tmp_path, turn):
    root = writers.nerfstudio(tmp_path / "a", marked)
    for path in (root / "images").iterdir():
        turned(path, turn)
    assert_same(views_of(root), truth)


@pytest.mark.parametrize("turn", [3, 6])
def test_poses_and_masks_for_photographs_as_stored(marked, truth, tmp_path, turn):
    root = writers.nerfstudio(tmp_path / "a", marked)
    for path in (root / "images").iterdir():
        marked_only(path, turn)
    assert_same(views_of(root), truth)


def test_poses_as_stored_and_masks_upright(marked, truth, tmp_path):
    root = writers.nerfstudio(tmp_path / "a", marked)
    for folder in ("images", "mattes"):
        for path in (root / folder).iterdir():
            marked_only(path, 6)
    for path in (root / "mattes").iterdir():
        with Image.open(path) as picture:
            upright = ImageOps.exif_transpose(picture)
        upright.save(path)
    assert_same(views_of(root), truth)


def test_poses_upright_and_masks_as_stored(marked, truth, tmp_path):
    root = writers.nerfstudio(tmp_path / "a", marked)
    for folder in ("images", "mattes"):
        for path in (root / folder).iterdir():
            turned(path, 7)
    for path in (root / "mattes").iterdir():
        Image.fromarray(np.asarray(Image.open(path))).save(path)
    assert_same(views_of(root), truth)


def test_alpha_turns_with_its_photograph(marked, tmp_path):
    root = writers.nerf_synthetic(tmp_path / "a", marked)
    truth = views_of(root)
    for path in (root / "train").iterdir():
        marked_only(path, 6)
    assert_same(views_of(root), truth)


def test_sparse_points_tell_where_there_are_no_masks(marked, tmp_path):
    from robir.capture.checks.photographs import prepared
    from robir.capture.recognise import read_frames

    root = writers.colmap(tmp_path / "a", marked, binary=True)
    for path in (root / "images").iterdir():
        turned(path, 3)
    frames = read_frames(root)
    chosen, _, told = prepared(frames, [(f, "train") for f in frames.frames], {})
    assert all(frame.is_upright for frame, _ in chosen)
    assert "upright" in told[0].message


def test_nothing_tells(marked, tmp_path):
    """A ball in the middle of every photograph, of one colour."""
    root = writers.nerfstudio(tmp_path / "a", marked)
    y, x = np.mgrid[0:64, 0:64] - 31.5
    disc = np.where(np.hypot(x, y) < 20, 255, 0).astype(np.uint8)
    poses = json.loads((root / "transforms.json").read_text())
    for path in (root / "images").iterdir():
        Image.fromarray(np.dstack([disc // 2] * 3)).save(path)
        Image.fromarray(disc).save(root / "mattes" / path.name)
        marked_only(path, 3)
    assert len(poses["frames"]) == 12
    with pytest.raises(CaptureRefusedError, match="EXIF data turns 12 photographs, and neither"):
        read_capture(root, None, CaptureConfig())


def test_damaged_masks_are_not_blamed_on_exif(marked, tmp_path):
    root = writers.nerfstudio(tmp_path / "a", marked)
    for path in (root / "images").iterdir():
        marked_only(path, 3)
    for path in (root / "mattes").iterdir():
        path.write_bytes(path.read_bytes()[:60])
    with pytest.raises(CaptureRefusedError, match="truncated or damaged"):
        read_capture(root, None, CaptureConfig())


@pytest.mark.skipif(REPORTS is None, reason="REPORTS NOT TESTED: the folder reports is absent")
def test_reported_square_photographs_are_turned():
    assert REPORTS is not None
    found = views_of(REPORTS / "b1_square_exif6_poses_upright")
    truth = views_of(REPORTS / "a1_reference_srgb")
    for view, other in zip(found, truth, strict=True):
        assert np.array_equal(view.mask, other.mask)
        inside = view.mask > 250
        error = np.abs(view.image_display[inside].astype(int) - other.image_display[inside])
        assert error.mean() < 4


@pytest.mark.skipif(REPORTS is None, reason="REPORTS NOT TESTED: the folder reports is absent")
def test_reported_upright_masks_are_turned_back():
    assert REPORTS is not None
    found = read_capture(REPORTS / "b2_portrait_exif6_masks_upright", None, CaptureConfig())
    assert abs(found.bounds.radius - 1.0) < 0.02
    told = next(finding for finding in found.findings if finding.code == "exif-turn")
    assert "poses are for photographs as stored, masks are drawn on photographs upright" in (
        told.message
    )
