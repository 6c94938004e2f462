# SPDX-License-Identifier: Apache-2.0
"""The whole method, much shortened, through the project's own evaluation."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import pytest
from evaluation import sphere_run

from robir import cli
from robir.config import RunConfig, resolve
from robir.jobs.paths import JobPaths, read_json, write_json
from robir_bench.paper.config import (
    NeusConfig,
    NormalsConfig,
    PaperConfig,
    VisibilityConfig,
    shrunken,
)
from robir_bench.paper.method import reconstruct_published


def tiny() -> PaperConfig:
    """Seconds of everything."""
    base = shrunken()
    return replace(
        base,
        neus=NeusConfig(
            iterations=60,
            rays=128,
            coarse_samples=16,
            fine_samples=16,
            rounds=2,
            depth=3,
            width=48,
            octaves=4,
            colour_depth=1,
            colour_width=32,
            learning_rate=5e-3,
            warm_up=5,
            image_side=64,
            cells=40,
        ),
        normals=NormalsConfig(iterations=20, smooth_after=5, points=256, width=32),
        visibility=VisibilityConfig(
            iterations=20, pixels=32, directions=32, width=32, indirect_width=32
        ),
        material=replace(base.material, iterations=60, pixels=64, width=64),
        refinement=replace(
            base.refinement, iterations=60, warm_up=10, pixels=64, depth=2, width=32
        ),
        pool=400,
        ratio_directions=64,
    )


@pytest.fixture(scope="module")
def truth(tmp_path_factory) -> Path:
    return sphere_run.make_truth(tmp_path_factory.mktemp("paper") / "sphere")


def test_a_sphere_goes_through_all_stages_and_the_evaluation(tmp_path, truth):
    whole = sphere_run.make_run(tmp_path / "whole")
    paths = JobPaths(tmp_path / "paper")
    shutil.copytree(whole.stage("capture"), paths.stage("capture"))
    write_json(paths.run, {"seconds": {"capture": {"cpu": 1.0}}, "peak_memory_bytes": {}})
    changes = ["appearance.texture_size=64", "geometry.face_budget=800"]
    config = resolve(RunConfig(), None, changes)
    held_out = reconstruct_published(paths, config, "paper", tiny())
    assert held_out["views"] == 3
    assert held_out["psnr"] > 10.0
    about = read_json(paths.run)
    assert set(about["seconds"]) == {"capture", "geometry", "transport", "appearance"}
    assert cli.main(["evaluate", str(paths.root), "--truth", str(truth)]) == 0
    found = read_json(paths.scores)
    assert found["mask_iou"] > 0.8
    assert found["normals"]["mean_degrees"] < 30.0
    assert found["tone_curve"]["family"] == "robir_aces"
    curve = read_json(paths.stage("appearance") / "tone_curve.json")
    assert 0.0 < curve["parameters"]["tone_gamma"] < 1.0
    light = read_json(paths.stage("appearance") / "light.json")["lobes"]
    assert len(light) == 128
