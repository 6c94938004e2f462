# SPDX-License-Identifier: Apache-2.0
"""`robir check` on what people point it at: posed captures with something odd among them."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from capture import writers
from capture.scene import Shot, cameras, shoot
from PIL import Image

from robir.cli import main

# a directory of tags that never ends
BROKEN_EXIF = b"\xff\xe1\x00\x20Exif\0\0MM\0*\0\0\0\x08\xff\xff" + b"\xfe" * 14


@pytest.fixture(scope="module")
def taken() -> list[Shot]:
    wide = [replace(camera, fx=300.0, fy=300.0) for camera in cameras(12, size=(240, 240))]
    return [shoot(camera, samples=1) for camera in wide]


@pytest.fixture
def studio(taken, tmp_path) -> Path:
    """A nerfstudio capture with masks."""
    writers.nerfstudio(tmp_path / "studio", taken)
    return tmp_path / "studio"


@pytest.fixture
def synthetic(taken, tmp_path) -> Path:
    """A NeRF-synthetic capture, which states one lens and no size."""
    return writers.nerf_synthetic(tmp_path / "synthetic", taken)


def edit(folder: Path, change: Callable[[dict], object]) -> None:
    path = folder / "transforms.json"
    table = json.loads(path.read_text())
    change(table)
    path.write_text(json.dumps(table))


def check(folder: Path, capsys, wanted: int = 0) -> dict[str, dict]:
    """Findings of `robir check` by their code."""
    assert main(["check", str(folder), "--json", "--progress", "plain"]) == wanted
    said = json.loads(capsys.readouterr().out)
    return {finding["code"]: finding for finding in said["findings"]}


def photographs(folder: Path) -> list[Path]:
    return sorted(path for path in folder.rglob("*.png") if path.parent.name in ("images", "train"))


def test_three_photographs(studio, capsys):
    edit(studio, lambda table: table.update(frames=table["frames"][:3]))
    found = check(studio, capsys)
    assert "Only 3 views" in found["few-views"]["message"]
    edit(studio, lambda table: table.update(frames=table["frames"][:2]))
    assert "at least 3 are needed" in check(studio, capsys, 3)["too-few-views"]["message"]


def test_all_the_same_photograph(studio, capsys):
    for folder in (studio / "images", studio / "mattes"):
        first, *others = sorted(folder.iterdir())
        for path in others:
            shutil.copy(first, path)
    found = check(studio, capsys, 3)["same-photograph"]
    assert found["level"] == "error"
    assert "All 12 photographs are the same" in found["message"]


def test_two_objects_in_the_masks(studio, capsys):
    for path in sorted((studio / "mattes").iterdir())[::2]:
        Image.fromarray(np.roll(np.array(Image.open(path)), 90, axis=1)).save(path)
    found = check(studio, capsys, 3)["masks-disagree"]
    assert "no object in common" in found["message"]


def test_mixed_cameras_with_their_own_lenses(studio, capsys):
    """Every second photograph is twice as large and says so."""

    def mix(table: dict) -> None:
        keys = ("fl_x", "fl_y", "cx", "cy", "w", "h")
        shared = {key: table.pop(key) for key in keys}
        for number, frame in enumerate(table["frames"]):
            factor = 1 + number % 2
            frame |= {key: factor * value for key, value in shared.items()}
            for key in ("file_path", "mask_path"):
                picture = Image.open(studio / frame[key])
                picture.resize((240 * factor, 240 * factor)).save(studio / frame[key])

    edit(studio, mix)
    found = check(studio, capsys)
    assert {finding["level"] for finding in found.values()} == {"note"}


def test_a_stitched_panorama_of_50_megapixels(synthetic, studio, capsys):
    for folder in (synthetic, studio):
        path = photographs(folder)[3]
        with Image.open(path) as picture:
            panorama = Image.new(picture.mode, (12000, 4200))
        panorama.save(path, compress_level=1)
        found = check(folder, capsys, 3)["wrong-size"]
        assert "12000x4200" in found["message"]
        assert found["files"] == [path.name]


def test_broken_exif(studio, capsys):
    path = photographs(studio)[0]
    again = path.with_suffix(".jpg")
    Image.open(path).convert("RGB").save(again, quality=95)
    content = again.read_bytes()
    again.write_bytes(content[:2] + BROKEN_EXIF + content[2:])
    path.unlink()
    edit(studio, lambda table: table["frames"][0].update(file_path=f"images/{again.name}"))
    found = check(studio, capsys)
    assert {finding["level"] for finding in found.values()} == {"note"}


def test_stray_files(studio, capsys):
    (studio / "images" / "notes.docx").write_bytes(b"notes")
    (studio / "images" / "Thumbs.db").write_bytes(b"thumbs")
    Image.new("RGB", (50, 50)).save(studio / "images" / "holiday.png")
    found = check(studio, capsys)["unposed-images"]
    assert found["files"] == ["holiday.png"]
