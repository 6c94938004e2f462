# SPDX-License-Identifier: Apache-2.0
"""One scene in every format: each reader gives the same cameras and masks."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from capture import writers
from capture.scene import assert_bits_alike, surface_points

from robir.capture import views
from robir.capture.capture import Capture
from robir.capture.config import CaptureConfig
from robir.capture.recognise import read_capture, read_frames
from robir.errors import CaptureError

TOLERANCE = 0.01
CENTRED = {
    "nerf-synthetic": writers.nerf_synthetic,
    "llff-text": lambda root, shots: writers.llff(root, shots, numeric=False),
    "llff-numeric": lambda root, shots: writers.llff(root, shots, numeric=True),
}
OFF_CENTRE = {
    "nerfstudio": writers.nerfstudio,
    "nerfstudio-frames": lambda root, shots: writers.nerfstudio(root, shots, per_frame=True),
    "colmap-binary": lambda root, shots: writers.colmap(root, shots, binary=True),
    "colmap-text": lambda root, shots: writers.colmap(root, shots, binary=False, folder="sparse"),
    "colmap-here": lambda root, shots: writers.colmap(root, shots, binary=True, folder="."),
    "neus": writers.neus,
}


def read(root: Path, masks: Path | None = None) -> Capture:
    return read_capture(root, masks, CaptureConfig())


def assert_same(capture: Capture, shots: list) -> None:
    """Every surface point projects alike, and masks are equal, picture by picture."""
    assert len(capture.views) == len(shots)
    assert "masks-disagree" not in {finding.code for finding in capture.findings}
    points = surface_points(300)
    for shot in shots:
        truth, depth = shot.camera.project(points)
        errors = []
        for view in capture.views:
            pixels, depths = view.camera.project(points)
            errors.append(np.abs(pixels - truth).max() + np.abs(depths - depth).max())
        nearest = capture.views[int(np.argmin(errors))]
        assert min(errors) <= TOLERANCE
        assert np.array_equal(nearest.mask, shot.rgba[:, :, 3])
        inside = nearest.mask == 255
        assert np.abs(nearest.image_display.astype(int) - shot.rgba[:, :, :3])[inside].max() <= 1


@pytest.mark.parametrize("name", CENTRED)
def test_formats_with_a_centred_lens(name, shots, tmp_path):
    CENTRED[name](tmp_path, shots)
    assert_same(read(tmp_path), shots)


@pytest.mark.parametrize("name", OFF_CENTRE)
def test_formats_with_an_off_centre_lens(name, odd_shots, tmp_path):
    OFF_CENTRE[name](tmp_path, odd_shots)
    capture = read(tmp_path)
    assert capture.format == name.split("-")[0]
    assert_same(capture, odd_shots)


@pytest.mark.parametrize(
    ("write", "name"),
    [
        (writers.nerfstudio, "transforms.json"),
        (writers.neus, "cameras_sphere.npz"),
        (lambda root, shots: writers.colmap(root, shots, binary=True), "sparse/0"),
    ],
)
def test_the_file_of_poses_can_be_given_instead_of_the_folder(write, name, odd_shots, tmp_path):
    write(tmp_path, odd_shots)
    masks = tmp_path / "masks"
    assert_same(read(tmp_path / name, masks if masks.is_dir() else None), odd_shots)


def test_formats_are_told_by_content(odd_shots, tmp_path):
    writers.neus(tmp_path / "neus", odd_shots)
    (tmp_path / "neus/cameras_sphere.npz").rename(tmp_path / "neus/everything.npz")
    assert read(tmp_path / "neus").format == "neus"
    writers.nerfstudio(tmp_path / "ngp", odd_shots)
    (tmp_path / "ngp/transforms.json").rename(tmp_path / "ngp/train.json")
    assert read(tmp_path / "ngp/train.json").format == "nerfstudio"


def test_the_larger_of_two_colmap_models_is_used(odd_shots, tmp_path):
    writers.colmap(tmp_path, odd_shots, binary=True, folder="sparse/1")
    writers.colmap(tmp_path, odd_shots[:3], binary=False, folder="sparse/0", tail="")
    writers.save_pictures(
        tmp_path / "images", odd_shots, [f"IMG_{7 * i:03d}.png" for i in range(8)], alpha=False
    )
    capture = read(tmp_path)
    assert_same(capture, odd_shots)
    assert "several-models" in {finding.code for finding in capture.findings}


def test_test_views_are_held_out_and_thinned(shots, tmp_path, monkeypatch):
    monkeypatch.setattr(views, "_MAX_HELD_OUT", 2)
    writers.nerf_synthetic(tmp_path, shots, tests=3)
    capture = read(tmp_path)
    assert [len(capture.train), len(capture.held_out)] == [5, 2]
    assert all(view.name.startswith("test_") for view in capture.held_out)


def test_another_format_of_the_same_views_is_the_same_capture_to_the_bit(shots, tmp_path):
    synthetic, studio = tmp_path / "synthetic", tmp_path / "studio"
    writers.nerf_synthetic(synthetic, shots, tests=2)
    shutil.copytree(synthetic, studio)
    parts = [json.loads((studio / f"transforms_{s}.json").read_text()) for s in ("train", "test")]
    tests = [frame["file_path"].removeprefix("./") for frame in parts[1]["frames"]]
    both = parts[0] | {"frames": parts[0]["frames"] + parts[1]["frames"], "test_filenames": tests}
    for split in ("train", "test"):
        (studio / f"transforms_{split}.json").unlink()
    (studio / "transforms.json").write_text(json.dumps(both))
    first, second = read(synthetic), read(studio)
    assert [first.format, second.format] == ["nerf-synthetic", "nerfstudio"]
    assert_bits_alike(first, second)


def test_without_test_views_every_eighth_is_held_out(shots, tmp_path):
    writers.nerf_synthetic(tmp_path, shots)
    capture = read(tmp_path)
    assert [view.name for view in capture.held_out] == ["r_4"]
    assert len({view.name for view in capture.views}) == 8


def test_a_scaled_blender_camera_is_the_same_camera(shots, tmp_path):
    writers.nerf_synthetic(tmp_path, shots)
    path = tmp_path / "transforms_train.json"
    content = json.loads(path.read_text())
    for frame in content["frames"]:
        matrix = np.array(frame["transform_matrix"])
        matrix[:3, :3] *= 2.5
        frame["transform_matrix"] = matrix.tolist()
    path.write_text(json.dumps(content))
    assert_same(read(tmp_path), shots)


def test_llff_photographs_of_half_the_declared_size(shots, tmp_path):
    writers.llff(tmp_path, shots, numeric=False)
    rows = np.load(tmp_path / "poses_bounds.npy")
    rows[:, [4, 9, 14]] *= 2
    np.save(tmp_path / "poses_bounds.npy", rows)
    assert_same(read(tmp_path), shots)


def test_neus_skew_is_refused(odd_shots, tmp_path):
    writers.neus(tmp_path, odd_shots)
    path = tmp_path / "cameras_sphere.npz"
    arrays = dict(np.load(path))
    arrays["world_mat_2"] = (
        np.array([[1, 0.2, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1.0]])
        @ arrays["world_mat_2"]
    )
    np.savez(path, **arrays)
    with pytest.raises(CaptureError, match="skewed pixel axes"):
        read_frames(tmp_path)


def test_reading_again_gives_the_same_value(odd_shots, tmp_path):
    writers.colmap(tmp_path, odd_shots, binary=True)
    one, two = read(tmp_path), read(tmp_path)
    assert one.findings == two.findings
    assert np.array_equal(one.bounds.centre, two.bounds.centre)
    assert one.bounds.radius == two.bounds.radius
