# SPDX-License-Identifier: Apache-2.0
"""What a poller sees of a run that is at work: metrics and a picture."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import torch
from capture.scene import cameras, shoot
from capture.writers import nerf_synthetic
from PIL import Image

from robir import cli
from robir.capture.camera import Camera
from robir.capture.capture import Bounds, Capture, View
from robir.capture.images.loading import PREVIEW_GREY, save_preview
from robir.geometry.fit.preview import Preview
from robir.jobs.paths import JobPaths, read_json
from robir.jobs.status import read_status
from robir.pipeline.runner import reconstruct
from tests.pipeline.fakes import Silent, fake_stages, make_capture, request


def test_status_carries_the_latest_metrics_live_and_of_finished_stages(tmp_path):
    stages, seen = fake_stages(), []

    def measure(context):
        for value in (10.0, 20.0):
            context.reporter.metric("held_out_psnr", value)
        context.reporter._last_status = 0.0
        context.reporter.progress(0.6, "going on")
        seen.append(dict(read_status(context.paths.status).metrics))

    stages["geometry"].mischief = measure
    out = tmp_path / "out"
    reconstruct(request(make_capture(tmp_path / "capture"), out), Silent(), stages)
    assert seen[0]["held_out_psnr"] == 20.0
    means = [read_json(JobPaths(out).manifest(name))["metrics"]["mean"] for name in stages]
    assert seen[0]["mean"] == means[0]
    last = read_status(JobPaths(out).status).metrics
    assert (last["held_out_psnr"], last["mean"]) == (20.0, means[-1])


def test_a_preview_is_the_photograph_and_the_rendering_side_by_side(tmp_path):
    photo = np.zeros((200, 400, 4), np.uint8)
    photo[:, 200:] = (200, 100, 50, 255)
    rendering = photo[:, ::-1].copy()
    save_preview(tmp_path / "preview.png", photo, rendering)
    with Image.open(tmp_path / "preview.png") as picture:
        pixels = np.array(picture)
    assert pixels.shape == (80, 320, 3)
    assert (pixels[:, :79] == PREVIEW_GREY).all() and (pixels[:, 241:] == PREVIEW_GREY).all()
    assert (pixels[:, 81:239] == (200, 100, 50)).all()


class _Metrics(dict):
    def metric(self, name, value):
        self[name] = value


@pytest.mark.parametrize("split", ["held_out", "train"])
def test_a_field_that_is_off_by_a_known_amount_scores_so(tmp_path, split):
    camera = Camera(width=40, height=40, fx=50.0, fy=50.0, cx=20.0, cy=20.0,
                    camera_to_world=np.eye(4))  # fmt: skip
    view = View(
        name="a",
        image_display=np.full((40, 40, 3), 102, np.uint8),
        mask=np.full((40, 40), 255, np.uint8),
        camera=camera,
        split=split,
    )
    bounds = Bounds(centre=np.zeros(3), radius=1.0, origin="")
    capture = Capture(source=tmp_path, format="", views=(view,), bounds=bounds)
    metrics = _Metrics()
    preview = Preview(capture, tmp_path / "preview.png", "cpu", metrics)
    before = torch.random.get_rng_state()

    def render(origins, directions):
        return torch.full((len(origins), 3), 0.5), torch.ones(len(directions))

    preview.show(render)
    (tmp_path / "preview.png").unlink()
    preview.show(render)  # too early for another
    assert not (tmp_path / "preview.png").exists()
    assert torch.equal(before, torch.random.get_rng_state())
    assert metrics == ({"held_out_psnr": 20.0} if split == "held_out" else {})


def test_check_tells_cameras_bounds_and_photographs(tmp_path, capsys):
    shots = [shoot(camera, samples=1) for camera in cameras(10)]
    root = nerf_synthetic(tmp_path / "a capture", shots, tests=2)
    assert cli.main(["check", str(root), "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert (facts["views"], facts["held_out"], len(facts["cameras"])) == (8, 2, 10)
    for camera in facts["cameras"]:
        path = Path(camera["image"])
        shot = shots[int(path.stem[2:]) + (8 if path.parent.name == "test" else 0)]
        np.testing.assert_allclose(camera["camera_to_world"], shot.camera.camera_to_world)
        assert camera["fx"] == pytest.approx(shot.camera.fx)
        with Image.open(camera["image"]) as photo:
            assert photo.size == (camera["width"], camera["height"])
