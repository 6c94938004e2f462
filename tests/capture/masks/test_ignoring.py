# SPDX-License-Identifier: Apache-2.0
"""Masks that say what to ignore, and findings that say one thing once."""

from __future__ import annotations

import shutil

import numpy as np
import pytest
from capture import writers
from capture.images.profiles import REPORTS
from PIL import Image

from robir.capture.capture import Finding
from robir.capture.config import CaptureConfig
from robir.capture.frames import PosedRefusedError
from robir.capture.poses.diagnose import Links, judge
from robir.capture.poses.sfm import Prepared
from robir.capture.poses.sources import find_photographs
from robir.capture.recognise import read_capture
from robir.capture.refusal import CaptureRefusedError, describe, error, grouped, note


def codes(findings) -> dict[str, Finding]:
    return {finding.code: finding for finding in findings}


def rig_mask() -> np.ndarray:
    """What a rig hides at the lower edge is black."""
    mask = np.full((48, 48), 255, np.uint8)
    mask[40:, 10:40] = 0
    return mask


@pytest.mark.parametrize("is_one_file", [True, False])
def test_one_mask_for_all_outlines_nothing(shots, tmp_path, is_one_file):
    root = writers.nerfstudio(tmp_path, shots)
    for path in (root / "mattes").iterdir():
        Image.fromarray(rig_mask()).save(path)
    table = root / "transforms.json"
    if is_one_file:
        text = table.read_text()
        for i in range(1, 8):
            text = text.replace(f"mattes/frame_{i:05d}", "mattes/frame_00000")
        table.write_text(text)
    capture = read_capture(root, None, CaptureConfig())
    said = codes(capture.findings)
    assert "all 8 photographs are the same picture" in said["ignore-masks"].message
    assert "backdrop-masks" in said
    truth = read_capture(writers.colmap(tmp_path / "b", shots, binary=True), None, CaptureConfig())
    shares = [np.mean([(v.mask > 128).mean() for v in c.views]) for c in (capture, truth)]
    assert shares[0] == pytest.approx(shares[1], abs=0.02)


def test_equal_outlines_within_the_picture_stay(shots, tmp_path):
    """A ball seen from everywhere has one outline; it does not reach the border."""
    root = writers.nerfstudio(tmp_path, shots)
    y, x = np.mgrid[0:48, 0:48] - 23.5
    disc = np.where(np.hypot(x, y) < 12, 255, 0).astype(np.uint8)
    for path in (root / "mattes").iterdir():
        Image.fromarray(disc).save(path)
    assert "ignore-masks" not in codes(read_capture(root, None, CaptureConfig()).findings)


def with_dynamic_masks(root) -> None:
    for path in sorted((root / "images").iterdir()):
        Image.fromarray(255 - rig_mask()).save(path.with_name(f"dynamic_mask_{path.stem}.png"))


def test_dynamic_masks_are_named_and_never_outlines(shots, tmp_path):
    root = writers.colmap(tmp_path, shots, binary=True)
    shutil.move(root / "masks", root / "mattes")
    with_dynamic_masks(root)
    said = codes(read_capture(root, None, CaptureConfig()).findings)
    assert "8 pictures dynamic_mask_*" in said["ignore-masks"].message
    assert "unposed-images" not in said
    with pytest.raises(CaptureRefusedError, match="holds photographs and no masks"):
        read_capture(root, root / "images", CaptureConfig())
    assert len(find_photographs(root / "images")) == 8


def test_photographs_with_alpha_may_be_their_own_masks(shots, tmp_path):
    root = writers.nerf_synthetic(tmp_path, shots)
    one = read_capture(root, root / "train", CaptureConfig())
    other = read_capture(root, None, CaptureConfig())
    for view, truth in zip(one.views, other.views, strict=True):
        assert np.array_equal(view.mask, truth.mask)


def test_findings_are_grouped(shots, tmp_path):
    root = writers.nerfstudio(tmp_path, shots)
    for grey, path in enumerate((root / "mattes").iterdir()):
        Image.new("L", (30, 48), 255 - grey).save(path)
    with pytest.raises(PosedRefusedError) as caught:
        read_capture(root, None, CaptureConfig())
    errors = [finding for finding in caught.value.findings if finding.level == "error"]
    assert len(errors) == 1
    assert "so it is with 7 more" in errors[0].message
    line = describe(errors[0])
    assert line.count("frame_0000") == 3 + 2  # three names, and mask and photograph of the first
    assert ", ...)" in line


def test_kinds_stay_apart():
    one, two = error("a", "x is bad", "Mend it.", "x"), error("a", "y is bad", "Mend it.", "y")
    other, word = error("a", "z is odd", "Look.", "z"), note("a", "w")
    found = grouped([one, other, two, word])
    assert [f.message for f in found] == ["x is bad; so it is with 1 more", "z is odd", "w"]
    assert found[0].files == ("x", "y")


@pytest.mark.skipif(REPORTS is None, reason="REPORTS NOT TESTED: the folder reports is absent")
@pytest.mark.parametrize("name", ["f1_one_mask_for_all", "f2_ngp_dynamic_masks"])
def test_reports_with_masks_to_ignore(name):
    assert REPORTS is not None
    capture = read_capture(REPORTS / name, None, CaptureConfig())
    assert "ignore-masks" in codes(capture.findings)
    assert 0.9 < capture.bounds.radius < 1.1
    if name.startswith("f2"):
        with pytest.raises(CaptureRefusedError, match="no masks that outline"):
            read_capture(REPORTS / name, REPORTS / name / "images", CaptureConfig())


def test_no_photograph_is_compared_with_itself():
    photographs = [
        Prepared(relative=f"IMG_{i}.jpg", copy=f"{i}.png", width=9, height=9, lens=0, focal=None)
        for i in range(6)
    ]
    nothing, motion = np.zeros((6, 6), np.int64), float("nan")
    (said,) = judge(photographs, Links(nothing, motion, 0.0), [])
    assert "IMG_0.jpg" not in said.message
    assert "no pair has any" in said.message
    some = nothing.copy()
    some[1, 4] = some[4, 1] = 7
    (said,) = judge(photographs, Links(some, motion, 0.0), [])
    assert "IMG_1.jpg and IMG_4.jpg, has 7 points" in said.message
