# SPDX-License-Identifier: Apache-2.0
"""A whole Blender without a window: `blender -b --command robir CAPTURE -o OUT`."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

SETTINGS = (
    "geometry.level_cells=[48, 80]",
    "geometry.level_steps=[100, 150]",
    "geometry.face_budget=5000",
    "transport.num_surfels=8000",
    "transport.num_directions=256",
    "appearance.texture_size=256",
    "export.render_views=1",
    "export.render_samples=8",
    "export.render_max_side=64",
)
"""A draft cut to a third of a CPU-minute."""


@pytest.fixture(scope="module")
def home(package, tmp_path_factory):
    """A user's folder with the add-on installed and enabled."""
    folder = tmp_path_factory.mktemp("home of a script")
    done = blender(folder, "extension", "install-file", "-r", "user_default", "-e", package)
    assert done.returncode == 0, done.stderr
    return folder


def blender(home: Path, *words: str | Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        ["blender", "-b", "--command", *words],
        capture_output=True,
        text=True,
        check=False,
        timeout=900,
        env={**os.environ, "HOME": str(home)},
    )


def test_a_reconstruction_from_photographs_to_a_relit_picture(home, capture, tmp_path):
    out = tmp_path / "the result's folder"
    changes = [word for setting in SETTINGS for word in ("--set", setting)]
    done = blender(
        home, "robir", capture, "-o", out, "--engine", sys.executable, "--preset", "draft", *changes
    )
    # so small a draft may well fail its own quality check, and is whole all the same
    status = json.loads((out / "status.json").read_text(encoding="utf-8"))
    assert (status["state"], status["exit_code"]) == ("done", done.returncode), done.stderr
    assert done.returncode in (0, 5)
    assert str(out) in done.stdout.splitlines()
    assert "geometry" in done.stderr
    # made by this very Blender, called by the engine
    assert (out / "export" / "scene.blend").is_file()
    assert list((out / "renders").glob("relit_*.png"))

    done = blender(home, "robir_scene", "render", out, "--views", "train", "--max-side", "8")
    assert done.returncode == 0, done.stderr
    reports = [line for line in done.stdout.splitlines() if line.startswith("{")]
    views = json.loads((out / "export" / "cameras.json").read_text(encoding="utf-8"))["views"]
    train = [view for view in views if view["split"] == "train"]
    assert len(json.loads(reports[-1])["files"]) == len(train)


def test_exit_codes_are_those_of_the_command_line(home, capture, tmp_path):
    empty = tmp_path / "no photographs"
    empty.mkdir()
    for words, code, sentence in (
        (["robir", capture, "-o", tmp_path / "out"], 4, "--engine PYTHON"),
        (["robir", empty, "-o", tmp_path / "out", "--engine", sys.executable], 3, "no photographs"),
        (["robir", capture, "--engine", sys.executable], 2, "-o"),
        (["robir", "--help"], 0, ""),
        (["robir_scene", "render", empty], 1, "cannot be read"),
        (["robir_scene", "paint", empty], 2, "invalid choice"),
    ):
        done = blender(home, *words)
        assert done.returncode == code, (words, done.stderr)
        assert sentence in done.stderr
