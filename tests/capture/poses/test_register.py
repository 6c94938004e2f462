# SPDX-License-Identifier: Apache-2.0
"""Poses against the truth, what is told on the way, and taking up again after kill -9."""

from __future__ import annotations

import shutil
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from capture.poses.room import COUNT, TARGET, Registered, Walk, align, photograph, ring
from PIL import Image

from robir.capture.config import CaptureConfig
from robir.capture.poses.register import register
from robir.capture.recognise import Workshop, read_capture
from robir.constants import changed
from robir.errors import CancelledError

pytestmark = pytest.mark.pycolmap


def by_code(findings) -> dict:
    return {finding.code: finding for finding in findings}


def number(name: str) -> int:
    return int("".join(c for c in name if c.isdigit()))


def check_poses(frames, cameras) -> None:
    """At most half a degree and one per cent of the camera distance."""
    truth = [cameras[number(frame.name)].camera_to_world for frame in frames]
    angles, distances = align([frame.camera_to_world for frame in frames], truth)
    away = np.median([np.linalg.norm(pose[:3, 3] - TARGET) for pose in truth])
    assert angles.max() < 0.5
    assert distances.max() < 0.01 * away


def test_poses_are_those_of_the_truth(walk: Walk, registered: Registered):
    frames = registered.frames.frames
    assert len(frames) == COUNT
    check_poses(frames, walk.cameras)
    lens = frames[0].lens
    assert lens.fx == pytest.approx(walk.cameras[0].fx, rel=0.01)
    assert abs(lens.cx - lens.width / 2) < 0.01 * lens.width
    assert len(registered.frames.points) > 500


def test_what_is_told(walk: Walk, registered: Registered):
    found = by_code(registered.frames.findings)
    assert found["stray-files"].files == ("notes.docx",)
    assert found["unreadable-images"].files == ("p99.jpg",)
    assert found["unreadable-images"].level == "warning"
    assert "20 of 20" in found["placed"].message
    assert "which way is up" in found["frame"].message
    for step in ("copying", "features", "matches", "placing cameras", "refining"):
        assert any(step in message for message in registered.messages)


def test_photographs_stay_as_they_are_and_the_work_is_small(walk: Walk, registered: Registered):
    names = {path.name for path in walk.folder.iterdir()}
    assert names == {f"p{i:02d}.png" for i in range(COUNT)} | {"masks", "notes.docx", "p99.jpg"}
    assert {path.name for path in registered.work.iterdir()} == {
        "model", "outcome.json", "photographs.json", "stamp.json", "pairs.txt"
    }  # fmt: skip
    assert all(frame.image.parent == walk.folder for frame in registered.frames.frames)


def test_done_is_done(walk: Walk, registered: Registered):
    messages = []
    again = register(walk.folder, registered.work, 0, lambda share, text: messages.append(text))
    assert messages == ["looking at the photographs"]
    for one, other in zip(again.frames, registered.frames.frames, strict=True):
        assert np.array_equal(one.camera_to_world, other.camera_to_world)
    assert again.findings == registered.frames.findings


def test_a_capture_comes_out_of_it(walk: Walk, registered: Registered):
    workshop = Workshop(folder=registered.work, seed=0)
    capture = read_capture(walk.folder, None, CaptureConfig(), workshop=workshop)
    assert capture.format == "photos"
    assert by_code(capture.findings)["mask-folder"]
    views = sorted(capture.views, key=lambda view: view.name)
    angles, _ = align(
        [view.camera.camera_to_world for view in views],
        [camera.camera_to_world for camera in walk.cameras],
    )
    assert angles.max() < 0.5
    # The boulder's ball is where the cameras see it.
    distance = np.median([np.linalg.norm(v.camera.position - capture.bounds.centre) for v in views])
    assert 0.15 < capture.bounds.radius / distance < 0.35


# in portions of so few photographs that half a walk has several
_KILLED = """
import os, signal, sys
from pathlib import Path
from robir.capture.poses.register import register
from robir.constants import changed

def tell(share, text):
    if text.startswith("looking for matches") and "of pair 1 " not in text:
        os.kill(os.getpid(), signal.SIGKILL)

with changed(["capture.poses.sfm._TILE=6"]):
    register(Path(sys.argv[1]), Path(sys.argv[2]), 0, tell)
"""


@pytest.fixture
def few(walk: Walk, tmp_path: Path) -> Path:
    """Half of the walk."""
    folder = tmp_path / "few"
    folder.mkdir()
    for i in range(COUNT // 2):
        shutil.copy(walk.folder / f"p{i:02d}.png", folder)
    return folder


def test_kill_9_and_on_from_the_database(few: Path, tmp_path: Path):
    """What follows a kill is the very model that an unbroken run makes."""
    work = tmp_path / "work"
    words = [sys.executable, "-c", _KILLED, str(few), str(work)]
    assert subprocess.run(words, check=False).returncode == -signal.SIGKILL
    began = (work / "copies" / "00000.png").stat().st_mtime_ns
    messages = []

    def tell(share, text):
        messages.append(text)
        if "cameras" in text:
            # The copies are still those of the killed process.
            assert (work / "copies" / "00000.png").stat().st_mtime_ns == began

    with changed(["capture.poses.sfm._TILE=6"]):
        register(few, work, 0, tell)
        register(few, tmp_path / "unbroken", 0, lambda share, text: None)
    assert not any(text.startswith("copying") for text in messages)
    for name in ("cameras.bin", "images.bin", "points3D.bin"):
        models = [(tmp_path / run / "model" / name).read_bytes() for run in ("work", "unbroken")]
        assert models[0] == models[1], name


def test_a_request_to_stop_is_heard_while_cameras_are_placed(few: Path, tmp_path: Path):
    """Also in the mapper's own loop, which is not ours."""

    def tell(share, text):
        if "placing cameras" in text:
            raise CancelledError("stopped on request")

    with pytest.raises(CancelledError):
        register(few, tmp_path / "work", 0, tell)


# how a camera that notes an EXIF orientation stores an upright picture
TURNS = {6: Image.Transpose.ROTATE_90, 8: Image.Transpose.ROTATE_270, 3: Image.Transpose.ROTATE_180}


def store(picture: np.ndarray, path: Path, orientation: int, focal_35: float | None) -> None:
    """Write a photograph as a camera does that was held another way."""
    image = Image.fromarray(picture)
    image = image.transpose(TURNS[orientation]) if orientation in TURNS else image
    exif = Image.Exif()
    exif[0x0112] = orientation
    if focal_35 is not None:
        exif[0x0110] = "Pocket 1"
        exif.get_ifd(0x8769)[0xA405] = round(focal_35)
    image.save(path, quality=97, exif=exif, subsampling=0)


def test_two_cameras_held_every_way_are_upright_exactly_once(tmp_path: Path):
    """Portrait and landscape, two lenses, EXIF turns; pictures and masks must fit the poses."""
    folder = tmp_path / "photos"
    (folder / "masks").mkdir(parents=True)
    wide, tall = ring(16), ring(16, size=(240, 320), focal=380.0)
    cameras = [(wide, tall)[i % 2][i] for i in range(16)]
    shots = [photograph(camera) for camera in cameras]
    for i, (picture, mask) in enumerate(shots):
        orientation = (1, 6, 3, 8)[i % 4]
        focal_35 = 380.0 * 43.27 / 400 if i % 2 else None
        store(picture, folder / f"p{i:02d}.jpg", orientation, focal_35)
        # Half of the masks were drawn on the pixels as stored.
        drawn = Image.fromarray(mask)
        drawn = drawn.transpose(TURNS[orientation]) if orientation in (6, 8) and i > 7 else drawn
        drawn.save(folder / "masks" / f"p{i:02d}.png")
    workshop = Workshop(folder=tmp_path / "work", seed=0)
    capture = read_capture(folder, None, CaptureConfig(), workshop=workshop)
    found = by_code(capture.findings)
    assert "2 cameras" in found["several-cameras"].message
    assert "8 of 16" in found["focal-length"].message
    assert "exif-orientation" in found
    views = sorted(capture.views, key=lambda view: view.name)
    assert len(views) == 16
    angles, _ = align(
        [view.camera.camera_to_world for view in views], [c.camera_to_world for c in cameras]
    )
    assert angles.max() < 0.5
    for view, camera, (picture, mask) in zip(views, cameras, shots, strict=True):
        # cut to the object
        assert view.camera.whole_size == pytest.approx((camera.width, camera.height))
        assert view.camera.fx == pytest.approx(camera.fx, rel=0.02)
        left, top = round(camera.cx - view.camera.cx), round(camera.cy - view.camera.cy)
        part = np.s_[top : top + view.camera.height, left : left + view.camera.width]
        picture, mask = picture[part], mask[part]
        away = np.abs(view.image_display.astype(float) - picture).mean()
        upside_down = np.abs(view.image_display.astype(float) - picture[::-1, ::-1]).mean()
        assert away < 0.6 * upside_down
        assert ((view.mask > 128) != (mask > 128)).mean() < 0.02
