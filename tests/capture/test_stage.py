# SPDX-License-Identifier: Apache-2.0
"""The stage's files, its metrics and what `robir check` notices."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from capture import writers
from capture.scene import CENTRE, Shot, assert_bits_alike, cameras, shoot
from PIL import Image

from robir.capture import stage
from robir.capture.capture import Bounds
from robir.capture.checks.findings import check_place, clipped_share, has_spike
from robir.capture.config import CaptureConfig
from robir.capture.recognise import check_capture, read_capture
from robir.capture.store import load_capture, save_capture, view_path
from robir.errors import CancelledError, CaptureError, ConfigError, StorageError
from robir.jobs.context import StageContext
from robir.jobs.paths import JobPaths


class Listener:
    """A reporter that remembers, and asks to stop after `patience` reports."""

    def __init__(self, patience: int = 1000) -> None:
        self.fractions: list[float] = []
        self.warnings: list[str] = []
        self.patience = patience

    def progress(self, fraction: float, message: str) -> None:
        assert message
        self.fractions.append(fraction)
        if len(self.fractions) > self.patience:
            raise CancelledError("asked to stop")

    def warn(self, message: str) -> None:
        self.warnings.append(message)

    def metric(self, name: str, value: object) -> None:
        raise AssertionError("the capture stage has no running metrics")


def context(source: Path, out: Path, listener: Listener) -> StageContext:
    return StageContext(
        paths=JobPaths(out),
        config=CaptureConfig(),
        source=source,
        masks=None,
        seed=0,
        device="cpu",
        reporter=listener,
    )


def codes(root: Path, masks: Path | None = None) -> dict[str, str]:
    """Level of every finding by code."""
    return {f.code: f.level for f in check_capture(root, masks, CaptureConfig())[1]}


def test_what_is_stored_is_what_was_read(odd_shots, tmp_path):
    source = writers.nerfstudio(tmp_path / "in", odd_shots)
    listener = Listener()
    metrics = stage.run(context(source, tmp_path / "out", listener))
    stored = load_capture(JobPaths(tmp_path / "out").stage("capture"))
    read = read_capture(source, None, CaptureConfig())
    assert stored.format == read.format == metrics["format"] == "nerfstudio"
    assert stored.findings == read.findings
    assert_bits_alike(stored, read)
    assert (metrics["views"], metrics["held_out"]) == (7, 1)
    assert 0.05 < metrics["mask_share"] < 0.5
    assert listener.fractions == sorted(listener.fractions)
    assert listener.fractions[-1] == 1.0
    assert any("Only 8 views" in warning for warning in listener.warnings)


def test_a_refused_capture_stores_nothing(tmp_path):
    (tmp_path / "in").mkdir()
    with pytest.raises(CaptureError, match="neither photographs"):
        stage.run(context(tmp_path / "in", tmp_path / "out", Listener()))
    assert not (tmp_path / "out").exists()


def test_stopping_in_between_stores_nothing(shots, tmp_path):
    source = writers.nerf_synthetic(tmp_path / "in", shots)
    with pytest.raises(CancelledError):
        stage.run(context(source, tmp_path / "out", Listener(patience=3)))
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("spoil", ["json", "picture", "size"])
def test_damaged_stage_files_are_told(shots, tmp_path, spoil):
    source = writers.nerf_synthetic(tmp_path / "in", shots)
    folder = tmp_path / "stage"
    save_capture(folder, read_capture(source, None, CaptureConfig()))
    picture = view_path(folder, "r_3")
    if spoil == "json":
        (folder / "capture.json").write_text("{}")
    elif spoil == "picture":
        picture.write_bytes(picture.read_bytes()[:200])
    else:
        Image.new("RGBA", (5, 5)).save(picture)
    with pytest.raises(StorageError, match="Run the capture stage again"):
        load_capture(folder)


def test_settings_out_of_range():
    with pytest.raises(ConfigError, match=r"capture\.max_side is 8"):
        CaptureConfig(max_side=8)


def test_a_good_capture_has_no_warnings(tmp_path):
    writers.neus(tmp_path, [shoot(c, samples=2) for c in cameras(14)])
    levels = codes(tmp_path)
    assert set(levels.values()) == {"note"}
    assert {"counts", "mask-share", "bounds"} <= set(levels)


def test_unposed_and_repeated_photographs(odd_shots, tmp_path):
    writers.colmap(tmp_path, odd_shots, binary=True)
    picture = tmp_path / "images/IMG_000.png"
    (tmp_path / "images/extra.png").write_bytes(picture.read_bytes())
    (tmp_path / "images/IMG_007.png").write_bytes(picture.read_bytes())
    levels = codes(tmp_path)
    assert levels["unposed-images"] == levels["duplicate-images"] == "warning"


def test_repeated_poses_and_odd_lenses(odd_shots, tmp_path):
    writers.colmap(tmp_path, odd_shots, binary=False)
    images = tmp_path / "sparse/0/images.txt"
    lines = images.read_text().splitlines()
    lines[3] = " ".join([lines[3].split()[0], *lines[1].split()[1:8], "4", lines[3].split()[9]])
    images.write_text("\n".join(lines) + "\n")
    lens = tmp_path / "sparse/0/cameras.txt"
    lens.write_text(lens.read_text() + "4 PINHOLE 48 48 300 300 24 24\n")
    levels = codes(tmp_path)
    assert levels["duplicate-poses"] == levels["focal-lengths"] == "warning"


def test_exposure(shots, tmp_path):
    bright = [Shot(s.camera, s.rgba.copy()) for s in shots]
    for shot in bright[:3]:
        shot.rgba[20:30, :, :3] = 255
    for shot in bright[3:5]:
        shot.rgba[:26, :, :3] = 1
    writers.nerf_synthetic(tmp_path, bright)
    levels = codes(tmp_path)
    assert levels["over-exposed"] == levels["under-exposed"] == "warning"
    assert levels["clipping"] == "note"
    views = read_capture(tmp_path, None, CaptureConfig()).views
    inside = np.concatenate([s.rgba[s.rgba[:, :, 3] >= 128][:, :3] for s in bright])
    assert clipped_share(views) == pytest.approx((inside == 255).any(axis=1).mean())
    writers.nerf_synthetic(tmp_path / "soft", shots)
    assert not has_spike(read_capture(tmp_path / "soft", None, CaptureConfig()).views)


def test_inverted_and_tiny_masks(odd_shots, tmp_path):
    writers.nerfstudio(tmp_path, odd_shots)
    for path in (tmp_path / "mattes").iterdir():
        Image.fromarray(255 - np.asarray(Image.open(path))).save(path)
    assert codes(tmp_path)["inverted-masks"] == "warning"
    tiny = np.zeros((48, 48), dtype=np.uint8)
    tiny[24:27, 23:26] = 255
    Image.fromarray(tiny).save(tmp_path / "mattes/frame_00001.png")
    assert codes(tmp_path)["tiny-masks"] == "warning"


def test_cameras_inside_the_object(shots, tmp_path):
    views = read_capture(writers.nerf_synthetic(tmp_path, shots), None, CaptureConfig()).views
    position = views[2].camera.position
    small = Bounds(centre=position + 0.1, radius=0.2, origin="hand")
    _, finding = check_place(views, small)
    assert (finding.code, finding.level) == ("cameras-inside", "warning")
    assert finding.files == (views[2].name,)
    assert len(check_place(views, Bounds(centre=CENTRE, radius=0.9, origin="hand"))) == 1
