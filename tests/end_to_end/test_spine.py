# SPDX-License-Identifier: Apache-2.0
"""Posed images in, a relit asset out, with bars on the accuracy; everything real.

The bars lie just below what this small capture and cut-down run reach; whoever makes a stage
better raises them.
"""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import numpy as np
import pytest

from robir.jobs.paths import STAGES, JobPaths, read_json
from tests.end_to_end.conftest import Spine, reconstruct_words, robir

pytestmark = [pytest.mark.slow, pytest.mark.blender]


@pytest.fixture(scope="module")
def scores(spine: Spine) -> dict:
    done = robir("evaluate", str(spine.out), "--truth", str(spine.capture), "--json")
    return json.loads(done.stdout)


def test_the_result_folder_is_complete(spine):
    paths = JobPaths(spine.out)
    products = [
        paths.asset, paths.scene, paths.environment, paths.light, paths.tone_curve, paths.tone_lut,
        paths.tone_plot, paths.cameras, paths.report, paths.report_json,
    ]  # fmt: skip
    assert not [path.name for path in products if not path.is_file()]
    assert {path.name for path in paths.textures.iterdir()} >= {"albedo.png", "roughness.png"}
    assert list(paths.renders.glob("rerender_*.png"))
    assert list(paths.renders.glob("relit_*.png"))


def test_nothing_is_written_outside_the_result_folder_but_settings_of_blender(spine):
    files = [path.relative_to(spine.home) for path in spine.home.rglob("*") if path.is_file()]
    own = ("HOME/.config/blender", "HOME/.cache/thumbnails", "HOME/Library")
    assert not [file for file in files if not any(file.is_relative_to(place) for place in own)]


def test_the_report_has_the_numbers_it_promises(spine):
    report = read_json(JobPaths(spine.out).report_json)
    assert set(STAGES) <= set(report["seconds"])
    assert report["held_out"]["psnr"] > 20.0
    assert {"device", "tone_curve", "choices"} <= report.keys()


def test_geometry_is_accurate(scores):
    assert scores["mask_iou"] > 0.955
    assert scores["normals"]["mean_degrees"] < 15.0
    assert scores["chamfer"]["chamfer"] < 10.0


def test_albedo_is_free_of_shadow(scores):
    ours = scores["albedo"]["psnr_linear"]["per_channel_lsq"]
    photo = scores["photo_as_albedo"]["psnr_linear"]["per_channel_lsq"]
    assert ours > 17.5
    assert ours > photo + 1.0
    assert 0.6 < scores["shadow"]["ratio"] < 1.2


def test_light_and_tone_curve_are_found(scores):
    assert scores["light"]["strongest_lobe_degrees"] < 5.0
    assert scores["tone_curve"]["family"] != "standard"


def test_cycles_shows_what_was_photographed(spine):
    assert read_json(JobPaths(spine.out).report_json)["cycles"]["psnr"] > 20.0


def test_a_second_start_does_nothing(spine):
    before = stage_hashes(spine.out)
    done = robir(*reconstruct_words(spine.capture, spine.out))
    assert "finished already" in done.stderr
    assert done.stdout.strip() == str(spine.out)
    assert stage_hashes(spine.out) == before


def stage_hashes(out: Path) -> dict[str, str]:
    """Hash of every array of every stage."""
    hashes = {}
    for path in sorted((out / "stages").rglob("*.npz")):
        with np.load(path, allow_pickle=False) as arrays:
            digest = hashlib.sha256()
            for name in sorted(arrays.files):
                digest.update(arrays[name].tobytes())
        hashes[path.relative_to(out).as_posix()] = digest.hexdigest()
    assert hashes
    return hashes


def test_a_setting_of_the_last_stage_runs_the_last_stage_only(spine, tmp_path):
    words = [*reconstruct_words(spine.capture, spine.out), "--set", "export.renders=false"]
    refused = robir(*words, expect=2)
    assert "export.renders: True -> False" in refused.stderr
