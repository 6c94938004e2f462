# SPDX-License-Identifier: Apache-2.0
"""The growing mesh: where it lies, how small it is, when it comes; held-out pictures."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
import trimesh
from geometry.scenes import Silent, capture_of

from robir.capture.capture import Bounds
from robir.capture.store import save_capture
from robir.geometry import stage
from robir.geometry.config import GeometryConfig
from robir.geometry.fit import preview
from robir.geometry.fit.preview import MAX_FACES, field_view, save_growing
from robir.geometry.mesh.triangles import Mesh
from robir.jobs.context import StageContext
from robir.jobs.paths import JobPaths

CONFIG = GeometryConfig(
    image_side=64, hull_cells=32, level_cells=(32, 48), level_steps=(60, 60), rays=512,
    face_budget=1500, stereo_side=0,
)  # fmt: skip

CENTRE, RADIUS = np.array([300.0, -70.0, 20.0]), 240.0  # a capture in millimetres


def in_millimetres(capture):
    views = []
    for view in capture.views:
        pose = view.camera.camera_to_world.copy()
        pose[:3, 3] = RADIUS * pose[:3, 3] + CENTRE
        views.append(replace(view, camera=replace(view.camera, camera_to_world=pose)))
    bounds = Bounds(centre=CENTRE, radius=RADIUS, origin="told")
    return replace(capture, views=tuple(views), bounds=bounds)


def test_the_stage_writes_it_with_every_preview_in_the_captures_frame(tmp_path, monkeypatch):
    solid = trimesh.creation.box((0.9, 0.7, 0.8))
    paths = JobPaths(tmp_path)
    save_capture(paths.stage("capture"), in_millimetres(capture_of(solid, views=16, low=-0.9)))
    monkeypatch.setattr(preview, "PERIOD", 0.0)
    paths.growing.write_bytes(b"of an earlier run")
    seen, previews = [], []

    def draw(*words):
        previews.append(paths.growing.exists())

    def save(path, surface, bounds):
        save_growing(path, surface, bounds)
        with np.load(path, allow_pickle=False) as arrays:
            seen.append({name: arrays[name] for name in arrays.files})

    monkeypatch.setattr(preview, "save_preview", draw)
    monkeypatch.setattr(stage, "save_growing", save)
    context = StageContext(
        paths=paths, config=CONFIG, source=tmp_path, masks=None, seed=0, device="cpu",
        reporter=Silent(),
    )  # fmt: skip
    stage.run(context)
    assert len(seen) == len(previews) == 6, "every 25 of 60 and 60 steps"
    assert previews == [False] + 5 * [True]
    for arrays in seen:
        assert set(arrays) == {"vertices", "faces"}
        vertices, faces = arrays["vertices"], arrays["faces"]
        assert vertices.dtype == np.float32 and vertices.shape[1:] == (3,)
        assert faces.dtype == np.int32 and 100 < len(faces) <= MAX_FACES
        assert faces.min() == 0 and faces.max() == len(vertices) - 1
    final = RADIUS * Mesh.load(paths.stage("geometry") / "mesh.npz").vertices + CENTRE
    last = seen[-1]["vertices"]
    for end in (np.min, np.max):
        np.testing.assert_allclose(end(last, 0), end(final, 0), atol=0.06 * RADIUS)
    shown = trimesh.Trimesh(last, seen[-1]["faces"])
    assert shown.volume == pytest.approx(RADIUS**3 * solid.volume, rel=0.15), "and outside is out"


@pytest.mark.parametrize("side", [400, 24])
def test_pictures_are_as_large_as_asked_and_lie_where_the_pixels_do(monkeypatch, side):
    """A field that shows each ray's own direction."""
    monkeypatch.setattr(preview, "RAYS", 100)
    monkeypatch.setattr(preview, "_HELD_OUT_SIDE", side)
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
