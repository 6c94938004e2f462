# SPDX-License-Identifier: Apache-2.0
"""Cameras for other programs, read back by our own readers and by pycolmap."""

from __future__ import annotations

import numpy as np
import pytest
from evaluation import sphere_run

from robir.capture.recognise import read_frames
from robir.capture.store import load_capture
from robir.evaluation.layers import stored_mesh
from robir.export.exchange import export_cameras


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    paths = sphere_run.make_run(tmp_path_factory.mktemp("run") / "out")
    capture = load_capture(paths.stage("capture"))
    export_cameras(paths, capture, stored_mesh(paths).vertices)
    return paths, capture


def assert_same_views(frames, views) -> None:
    by_name = {frame.image.stem: frame for frame in frames}
    assert set(by_name) == {view.name for view in views}
    for view in views:
        frame, camera = by_name[view.name], view.camera
        found = frame.lens.camera(frame.camera_to_world, camera.width, camera.height)
        assert frame.lens.size == (camera.width, camera.height)
        np.testing.assert_allclose(found.camera_to_world, camera.camera_to_world, atol=1e-6)
        for key in ("fx", "fy", "cx", "cy"):
            assert getattr(found, key) == pytest.approx(getattr(camera, key), abs=1e-6)
        assert frame.image.is_file()


def test_transforms_are_read_back(exported):
    paths, capture = exported
    found = read_frames(paths.transforms, "take")
    assert_same_views(found.frames, capture.views)
    held_out = {frame.image.stem for frame in found.frames if frame.split == "test"}
    assert held_out == {view.name for view in capture.held_out} != set()


@pytest.mark.pycolmap
def test_pycolmap_reads_the_same_cameras(exported):
    import pycolmap

    paths, capture = exported
    model = pycolmap.Reconstruction(paths.colmap / "sparse/0")
    assert model.num_points3D() > 100
    for view in capture.views:
        image = model.find_image_with_name(f"{view.name}.png")
        lens = view.camera
        assert image.camera.params == pytest.approx([lens.fx, lens.fy, lens.cx, lens.cy], abs=1e-6)
        look = np.vstack([image.cam_from_world().matrix(), [0, 0, 0, 1]])
        back = np.linalg.inv(look) @ np.diag([1, -1, -1, 1])
        np.testing.assert_allclose(back, lens.camera_to_world, atol=1e-6)
