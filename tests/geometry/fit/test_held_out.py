# SPDX-License-Identifier: Apache-2.0
"""What the finished field shows of photographs that it was not fitted to."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
import trimesh
from geometry.scenes import capture_of

from robir.capture.store import save_capture
from robir.geometry import stage
from robir.geometry.config import GeometryConfig
from robir.geometry.fit import held_out
from robir.geometry.fit.held_out import field_view
from robir.jobs.context import StageContext
from robir.jobs.paths import JobPaths

CONFIG = GeometryConfig(
    image_side=64, hull_cells=32, level_cells=(32, 48), level_steps=(120, 120), rays=1024,
    face_budget=1500, refine_poses=False, stereo_side=0,
)  # fmt: skip
"""Without depth maps, which would end so short a fit on some processors."""


class Silent:
    def progress(self, fraction, message):
        assert 0.0 <= fraction <= 1.0

    def warn(self, message):
        pass

    def metric(self, name, value):
        pass


def test_the_stage_keeps_the_fields_own_pictures(tmp_path):
    solid = trimesh.creation.box((0.9, 0.7, 0.8))
    capture = capture_of(solid, views=20, low=-0.9)
    views = tuple(
        replace(view, split="held_out") if k in (5, 11) else view
        for k, view in enumerate(capture.views)
    )
    paths = JobPaths(tmp_path)
    save_capture(paths.stage("capture"), replace(capture, views=views))
    context = StageContext(
        paths=paths, config=CONFIG, source=tmp_path, masks=None, seed=0, device="cpu",
        reporter=Silent(),
    )  # fmt: skip
    stage.run(context)
    with np.load(paths.stage("geometry") / "field_held_out.npz") as pictures:
        assert set(pictures.files) == {"view_005", "view_011"}
        for view in (views[5], views[11]):
            shown = pictures[view.name]
            assert shown.shape == (64, 64, 4) and shown.dtype == np.uint8
            whole = view.mask == 255
            off = (shown[..., :3].astype(float) - view.image_display)[whole] / 255
            assert -10 * np.log10((off**2).mean()) > 17
            assert shown[whole, 3].mean() > 240
            assert not shown[view.mask == 0].any()


@pytest.mark.parametrize("side", [400, 24])
def test_pictures_are_as_large_as_asked_and_lie_where_the_pixels_do(monkeypatch, side):
    """A field that shows each ray's own direction."""
    monkeypatch.setattr(held_out, "RAYS", 100)
    monkeypatch.setattr(held_out, "_IMAGE_SIDE", side)
    view = capture_of(trimesh.creation.icosphere(radius=0.7), views=3, side=48).views[0]

    def render(origins, directions):
        return 0.5 + 0.5 * directions, torch.full((len(origins),), 0.6)

    shown = field_view(view, render, "cpu")
    size = min(side, 48)
    assert shown.shape == (size, size, 4)
    camera = view.camera.resized(size, size)
    directions = camera.rays(camera.pixel_centres())[1].reshape(size, size, 3)
    inside = shown[..., 3] > 0
    assert set(np.unique(shown[..., 3])) == {0, 153}
    assert np.abs(shown[inside, :3] - 255 * (0.5 + 0.5 * directions[inside])).max() <= 1
    share = (view.mask > 0).mean()
    assert inside.mean() == pytest.approx(share, abs=0.05)
