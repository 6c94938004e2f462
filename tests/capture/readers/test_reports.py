# SPDX-License-Identifier: Apache-2.0
"""Situations that people report of other readers, rebuilt small, against the true cameras.

`a1_reference_srgb` is the same capture in a form that is read rightly.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from robir.capture.checks.findings import check_frames
from robir.capture.config import CaptureConfig
from robir.capture.frames import FrameSet
from robir.capture.mesh_file import read_mesh
from robir.capture.recognise import Workshop, read_frames, read_or_filmed
from robir.capture.views import unheard
from robir.errors import CaptureError

REPORTS = Path(__file__).parents[4] / "shared" / "reports"

pytestmark = pytest.mark.skipif(
    not REPORTS.is_dir(), reason=f"REPORTED CAPTURES NOT TESTED: {REPORTS} is not there"
)

# folder: format, photographs, of these held out, masks, what is said
CASES = {
    "c1_metashape_rig": ("metashape", 20, 0, 0, set()),
    "c2_metashape_groups_same_labels": ("metashape", 20, 0, 0, set()),
    "c3_metashape_two_components": ("metashape", 14, 0, 0, {"several-parts"}),
    "c4_metashape_rolling_shutter": ("metashape", 20, 0, 0, {"rolling-shutter"}),
    "c5_metashape_two_chunks": ("metashape", 20, 0, 0, {"several-parts"}),
    "d1_odm_opensfm": ("opensfm", 20, 0, 0, set()),
    "d2_realitycapture_xmp": ("realityscan-xmp", 20, 0, 0, set()),
    "d3_bundler": ("bundler", 20, 0, 0, set()),
    "d4_sdfstudio": ("sdfstudio", 20, 0, 20, set()),
    "d5_nerfactor_tensoir": ("nerfactor", 20, 3, 0, set()),
    "e2_colmap_without_second_lines": ("colmap", 20, 0, 0, set()),
    "f3_scannetpp": ("nerfstudio", 18, 4, 0, {"bad-frames"}),
    "f4_blendernerf_sof": ("nerf-synthetic", 20, 0, 0, {"poses-only"}),
    "f5_paths_of_another_machine": ("nerfstudio", 20, 0, 0, {"found-by-name"}),
}


@pytest.fixture(scope="module")
def truth() -> FrameSet:
    return read_frames(REPORTS / "a1_reference_srgb")


@pytest.mark.parametrize("name", CASES)
def test_cameras_are_those_of_the_truth(name, truth):
    form, count, tests, masks, said = CASES[name]
    found = read_frames(REPORTS / name)
    assert found.format == form
    assert len(found.frames) == count
    assert sum(frame.split == "test" for frame in found.frames) == tests
    assert sum(frame.mask is not None and frame.mask.is_file() for frame in found.frames) == masks
    assert {finding.code for finding in found.findings} == said
    assert not [finding for finding in check_frames(found) if finding.level == "error"]
    poses = np.array([frame.camera_to_world for frame in truth.frames])
    matched = set()
    for frame in found.frames:
        apart = np.abs(poses - frame.camera_to_world).max(axis=(1, 2))
        matched.add(int(apart.argmin()))
        assert apart.min() < 1e-6
        camera = frame.lens.camera(frame.camera_to_world, 80, 80)
        right = truth.frames[0].lens.camera(frame.camera_to_world, 80, 80)
        assert camera.fx == pytest.approx(right.fx, abs=1e-5)
        assert (camera.fy, camera.cx, camera.cy) == pytest.approx((right.fx, 40.0, 40.0), abs=1e-5)
    assert len(matched) == count


def test_of_two_files_of_poses_the_one_with_the_lens_counts():
    found = read_frames(REPORTS / "e3_llff_beside_colmap_with_lens")
    assert found.format == "colmap"
    assert {frame.lens.distortion.radial[0] for frame in found.frames} == {-0.3}
    assert "poses_bounds.npy is left aside" in found.findings[0].message


def test_a_recording_whose_frames_are_in_its_video(truth, tmp_path):
    with pytest.raises(CaptureError, match=r"Stray Scanner.*ffmpeg -i rgb\.mp4"):
        read_frames(REPORTS / "d6_strayscanner")
    pytest.importorskip("av", reason="VIDEO NOT TESTED: no av")
    workshop = Workshop(folder=tmp_path, seed=0)
    found = read_or_filmed(REPORTS / "d6_strayscanner", CaptureConfig(), workshop, unheard)
    poses = np.array([frame.camera_to_world for frame in truth.frames])
    for frame in found.frames:
        assert np.abs(poses - frame.camera_to_world).max(axis=(1, 2)).min() < 1e-5
    assert len(found.frames) == 20


def test_a_quantised_mesh_keeps_its_layout():
    given = read_mesh(REPORTS / "g1_mesh_quantized" / "ball.glb")
    assert given.uvs.min() >= 0
    assert 0.5 < given.uvs.max() <= 1


def test_a_mesh_compressed_with_draco_is_refused_by_name():
    with pytest.raises(CaptureError, match="compressed with Draco"):
        read_mesh(REPORTS / "g2_mesh_draco" / "ball.glb")
