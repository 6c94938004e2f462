# SPDX-License-Identifier: Apache-2.0
"""A capture dropped on Blender, and what is left when all is disabled."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from addon.blenders import run
from capture.scene import cameras, shoot
from capture.writers import colmap, nerf_synthetic

pytestmark = pytest.mark.blender

SESSION = (Path(__file__).parent / "drop_session.py").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("file", "capture"),
    [
        ("truck/transforms.json", "truck"),
        ("mouse/sparse/0/cameras.bin", "mouse"),
        ("mouse/colmap/sparse/0/cameras.bin", "mouse"),
        ("mouse/model/cameras.txt", "mouse/model"),
        ("scissors/cameras_sphere.npz", "scissors"),
        ("carton/poses_bounds.npy", "carton"),
        ("stone/Internal_ExternalCameraParameters.csv", "stone"),
        ("shoe/my cameras.XML", "shoe"),
        ("walk/IMG_0001.JPG", "walk"),
        ("walk/IMG_0001.heif", "walk"),
        ("walk/raw/1.CR3", "walk/raw"),
        ("walk/around.MOV", "walk/around.MOV"),
        ("truck/settings.json", None),
        ("truck/depth.npz", None),
        ("truck/database.bin", None),
    ],
)
def test_the_folder_that_a_file_stands_for(file, capture):
    from robir_addon.panels.menus import capture_folder

    root = Path("/captures with 'quotes'")
    assert capture_folder(root / file) == (root / capture if capture else None)


@pytest.fixture(scope="module")
def captures(tmp_path_factory):
    """One capture with files to drop in its folder, one with them far below it."""
    shots = [shoot(camera, samples=2) for camera in cameras(14)]
    folder = tmp_path_factory.mktemp("captures")
    plain = nerf_synthetic(folder / "it's Gänse", shots, tests=2)
    deep = colmap(folder / "deep", shots, binary=True)
    (model,) = deep.rglob("cameras.*")
    from hostile.test_videos import film

    return plain, deep, model, film(folder / "a walk.mp4", 4)


def test_dropped_kept_and_gone(newest, extension_zip, captures, tmp_path):
    plain, deep, model, video = captures
    answer = run(
        newest, SESSION, str(extension_zip), sys.executable, str(plain), str(model), str(video),
        user=tmp_path / "user",
    )  # fmt: skip
    dropped = answer["dropped"]
    assert dropped["drop"] == [["FINISHED"], str(plain)]
    assert dropped["recognised"] == "14 photographs with cameras (nerf-synthetic)"
    assert dropped["cameras"] == 14
    assert dropped["undone"] == [0, ""]
    assert dropped["redone"] == [14, str(plain)]
    assert answer["colmap"][1] == str(deep)
    said, taken, looked_at = answer["video"]
    assert taken == looked_at == str(video)
    assert "4 frames of a walk.mp4" in said, "its frames were looked at, and are too few"
    assert answer["elsewhere"][1] == "", "only the 3D viewport takes captures"
    assert "notes.txt holds no cameras" in answer["foreign"]
    assert not answer["busy"]
    assert answer["reopened"] == [["", "", 0]] * 2 + ["4K"], "only settings are saved"
    there = answer["there"]
    assert there["scene"] and there["state"] and there["handlers"] and there["menus"]
    assert answer["disabled"] == answer["untouched"]
    assert answer["enabled"] == there
    assert not answer["untouched"]["scene"] and not answer["untouched"]["classes"]
