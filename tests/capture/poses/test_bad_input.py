# SPDX-License-Identifier: Apache-2.0
"""What people point the program at: each a clear message, exit code 3, and what to do instead."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from capture.poses.room import TARGET, Walk, look_at, photograph, ring
from PIL import Image

from robir import cli
from robir.capture.camera import Camera
from robir.capture.config import CaptureConfig
from robir.capture.poses import sfm
from robir.capture.poses.register import FEATURE_SIDE, prepare, register
from robir.capture.recognise import check_capture
from robir.capture.refusal import CaptureRefusedError


def refusal_of(folder: Path, work: Path) -> CaptureRefusedError:
    with pytest.raises(CaptureRefusedError) as caught:
        register(folder, work, 0, lambda share, text: None)
    assert caught.value.exit_code == 3
    return caught.value


def codes(findings) -> dict:
    return {finding.code: finding for finding in findings}


def save(pictures, folder: Path, kind: str = "png") -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    for i, picture in enumerate(pictures):
        Image.fromarray(picture).save(folder / f"p{i:02d}.{kind}")
    return folder


@pytest.mark.pycolmap
def test_three_photographs(walk: Walk, tmp_path: Path, capsys):
    folder = save(walk.pictures[:3], tmp_path / "three")
    assert cli.main(["check", str(folder)]) == 3
    said = capsys.readouterr().out
    assert "3 different photographs" in said
    assert "at least 6" in said
    assert "30 to 100" in said


@pytest.mark.pycolmap
def test_all_the_same_photograph(walk: Walk, tmp_path: Path):
    refused = refusal_of(save(walk.pictures[:1] * 9, tmp_path / "same"), tmp_path / "work")
    assert "All 9 photographs are the same" in str(refused)


@pytest.mark.pycolmap
def test_the_same_place_again_and_again(walk: Walk, tmp_path: Path):
    """A tripod: pictures differ by noise alone."""
    rng = np.random.default_rng(0)
    noisy = [walk.pictures[0] + rng.normal(0, 4, walk.pictures[0].shape) for _ in range(7)]
    folder = save([n.clip(0, 255).astype(np.uint8) for n in noisy], tmp_path / "tripod")
    refused = refusal_of(folder, tmp_path / "work")
    assert codes(refused.findings).keys() & {"no-baseline"}, str(refused)
    assert "same place" in str(refused)


def test_repeated_photographs_are_left_out(walk: Walk, tmp_path: Path):
    folder = save([*walk.pictures[:7], walk.pictures[2]], tmp_path / "twice")
    files = sorted(folder.iterdir())
    entries, findings = prepare(folder, files, tmp_path / "copies", lambda share, text: None)
    assert len(entries) == 7
    assert codes(findings)["repeated-images"].files == ("p07.png",)


@pytest.mark.pycolmap
def test_two_objects(tmp_path: Path):
    cameras = ring(24)[:12:2] + ring(24)[1:12:2]
    pictures = [photograph(camera, seed=i // 6)[0] for i, camera in enumerate(cameras)]
    refused = refusal_of(save(pictures, tmp_path / "two"), tmp_path / "work")
    found = codes(refused.findings)
    assert found.keys() & {"two-groups", "no-overlap"}, str(refused)
    assert "p00.png to p05.png" in str(refused)
    assert "p06.png to p11.png" in str(refused)
    assert "15 degrees" in str(refused)


@pytest.mark.pycolmap
def test_a_camera_that_turns_on_the_spot(tmp_path: Path):
    place = ring(24)[0].camera_to_world[:3, 3]
    pictures = []
    for i in range(7):
        aim = TARGET + np.array([0.0, 0.12 * (i - 3), 0.05 * i])
        lens = {"width": 320, "height": 240, "fx": 340.0, "fy": 340.0, "cx": 160.0, "cy": 120.0}
        pictures.append(photograph(Camera(camera_to_world=look_at(place, aim), **lens))[0])
    refused = refusal_of(save(pictures, tmp_path / "turn"), tmp_path / "work")
    assert "no-parallax" in codes(refused.findings), str(refused)


@pytest.mark.pycolmap
def test_nothing_to_hold_on_to(tmp_path: Path):
    """Blank pictures of slightly different greys."""
    pictures = [np.full((120, 160, 3), 100 + i, np.uint8) for i in range(7)]
    refused = refusal_of(save(pictures, tmp_path / "blank"), tmp_path / "work")
    assert "no-matches" in codes(refused.findings)
    assert "patterned cloth" in str(refused)


def test_damaged_exif_and_a_panorama_of_50_megapixels(walk: Walk, tmp_path: Path):
    folder = save(walk.pictures[:7], tmp_path / "odd", "jpg")
    torn = folder / "p00.jpg"
    content = torn.read_bytes()
    torn.write_bytes(content[:2] + b"\xff\xe1\x00\x20Exif\0\0MM\0*\0\0\0\x08\xff\xff" + b"\xfe" * 14
                     + content[2:])  # fmt: skip
    small = Image.fromarray(np.hstack(walk.pictures[7:11]))
    small.resize((12000, 4200)).save(folder / "pano.jpg")
    entries, findings = prepare(
        folder, sorted(folder.iterdir()), tmp_path / "copies", lambda share, text: None
    )
    found = codes(findings)
    assert found["panorama"].files == ("pano.jpg",)
    assert max(entries[-1].width, entries[-1].height) == FEATURE_SIDE


def test_without_pycolmap_the_refusal_names_the_extra(walk: Walk, monkeypatch):
    monkeypatch.setattr(sfm, "is_available", lambda: False)
    capture, findings, _ = check_capture(walk.folder, None, CaptureConfig())
    assert capture is None
    assert findings[0].code == "no-poses"
    assert "pip install 'robir[photos]'" in findings[0].cure


@pytest.mark.parametrize(
    ("name", "package"), [("a.heic", "pillow_heif"), ("a.dng", "rawpy"), ("a.mp4", "av")]
)
def test_missing_packages_are_named(tmp_path: Path, monkeypatch, name: str, package: str):
    monkeypatch.setitem(sys.modules, package, None)
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / name).write_bytes(b"unseen")
    is_video = name.endswith("mp4")
    source = tmp_path / "in" / name if is_video else tmp_path / "in"
    refused = refusal_of(source, tmp_path / "work")
    assert "missing-reader" in codes(refused.findings)
    assert "pip install 'robir[photos]'" in str(refused)
