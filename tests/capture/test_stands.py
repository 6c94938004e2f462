# SPDX-License-Identifier: Apache-2.0
"""Of a capture that is refused for want of masks, the cameras can be seen all the same."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from capture.scene import AIM, cameras, shoot
from capture.writers import nerfstudio
from PIL import Image

from robir.cli import main


@pytest.fixture
def shots():
    return [shoot(camera, samples=1) for camera in cameras(8)]


@pytest.fixture
def maskless(shots, tmp_path: Path) -> Path:
    """A capture without masks and with nothing that they could be guessed from."""
    root = nerfstudio(tmp_path / "capture", shots)
    shutil.rmtree(root / "mattes")
    generator = np.random.default_rng(0)
    for path in sorted((root / "images").iterdir()):
        Image.fromarray(generator.integers(0, 255, (48, 48, 3), np.uint8)).save(path)
    table = json.loads((root / "transforms.json").read_text())
    for frame in table["frames"]:
        del frame["mask_path"]
    (root / "transforms.json").write_text(json.dumps(table))
    return root


def looked_at(source: Path, capsys) -> dict:
    assert main(["check", str(source), "--json"]) == 3
    return json.loads(capsys.readouterr().out)


def test_cameras_and_what_they_look_at_are_told(maskless: Path, shots, capsys):
    facts = looked_at(maskless, capsys)
    assert not facts["accepted"]
    assert facts["findings"][0]["code"] == "no-masks"
    assert len(facts["cameras"]) == len(shots)
    for entry, shot in zip(facts["cameras"], shots, strict=True):
        assert np.allclose(entry["camera_to_world"], shot.camera.camera_to_world, atol=1e-6)
        assert (entry["width"], entry["height"]) == (48, 48)
        assert entry["fx"] == pytest.approx(shot.camera.fx)
        assert Path(entry["image"]).is_file()
    assert np.linalg.norm(np.array(facts["centre"]) - AIM) < 0.3
    assert facts["radius"] > 0


def test_a_photograph_that_cannot_be_read_is_left_out(maskless: Path, shots, capsys):
    first = sorted((maskless / "images").iterdir())[0]
    first.write_bytes(b"no picture")
    assert len(looked_at(maskless, capsys)["cameras"]) == len(shots) - 1


def test_poses_that_make_no_sense_are_not_shown(maskless: Path, capsys):
    table = json.loads((maskless / "transforms.json").read_text())
    for frame in table["frames"]:
        frame["transform_matrix"] = [[0.0] * 4] * 4
    (maskless / "transforms.json").write_text(json.dumps(table))
    assert "cameras" not in looked_at(maskless, capsys)
