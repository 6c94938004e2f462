# SPDX-License-Identifier: Apache-2.0
"""Real captures that nobody here made; skipped, loudly, where the data folder is absent."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from robir.capture.config import CaptureConfig
from robir.capture.poses import sfm
from robir.capture.recognise import check_capture, read_frames

DATA = Path(__file__).parents[3] / "shared" / "data"
SMALL = CaptureConfig(max_side=96)
ALARMS = {"blurred", "brightness-changes", "moving-light", "turntable"}

pytestmark = pytest.mark.skipif(
    not DATA.is_dir(), reason=f"REAL CAPTURES NOT TESTED: the data folder {DATA} is absent"
)


def levels(findings) -> dict[str, str]:
    return {finding.code: finding.level for finding in findings}


def test_scissors_neus():
    capture, findings, _ = check_capture(DATA / "scissors_neus", None, SMALL)
    assert "error" not in levels(findings).values()
    assert capture is not None
    assert len(capture.views) == 49
    assert capture.format == "neus"
    # World frame of world_mat: millimetres, with the promised sphere about (-27, -44, 741).
    assert np.linalg.norm(capture.bounds.centre - [-27.0, -44.0, 740.6]) < 100
    assert 150 < capture.bounds.radius <= 256.1
    # One side was photographed, sharply, under a lamp and an exposure that stayed.
    assert levels(findings)["coverage-gap"] == "warning"
    assert not ALARMS & levels(findings).keys()


def test_milk_carton_llff_is_matted_and_ordered_by_text():
    capture, findings, _ = check_capture(DATA / "milk_carton_llff", None, SMALL)
    assert "error" not in levels(findings).values()
    assert capture is not None
    assert len(capture.views) == 43
    order = next(finding for finding in findings if finding.code == "pose-order")
    assert "names as text" in order.message
    assert capture.bounds.radius < 2.3
    # The same sides are bright in some photographs and in shadow in others.
    assert ALARMS & levels(findings).keys() == {"brightness-changes"}


@pytest.mark.slow
def test_a_capture_without_masks_is_given_some(tmp_path):
    """Every sixth photograph once around a packet of gum, and one that nobody posed."""
    table = json.loads((DATA / "gum_nerfstudio" / "transforms.json").read_text())
    table["frames"] = table["frames"][::6]
    (tmp_path / "transforms.json").write_text(json.dumps(table))
    (tmp_path / "images").mkdir()
    for name in (*(frame["file_path"] for frame in table["frames"]), "images/0006.jpg"):
        shutil.copy(DATA / "gum_nerfstudio" / name, tmp_path / name)
    capture, findings, _ = check_capture(tmp_path, None, SMALL)
    assert capture is not None
    assert "masks were guessed" in next(f for f in findings if f.code == "guessed-masks").message
    counts = next(finding for finding in findings if finding.code == "counts")
    assert f"{len(table['frames'])} posed" in counts.message
    assert levels(findings)["unposed-images"] == "warning"


def test_mouse_colmap():
    frames = read_frames(DATA / "mouse_colmap")
    assert (len(frames.frames), frames.format) == (56, "colmap")
    assert len(frames.points) > 1000


def test_photographs_without_poses_are_refused_where_pycolmap_is_missing(monkeypatch):
    monkeypatch.setattr(sfm, "is_available", lambda: False)
    capture, findings, _ = check_capture(DATA / "banana_photos", None, SMALL)
    assert capture is None
    assert findings[0].code == "no-poses"
    assert "16 photographs but no camera poses" in findings[0].message
    assert "COLMAP" in findings[0].cure
