# SPDX-License-Identifier: Apache-2.0
"""A whole Blender without a window: `blender -b --command robir CAPTURE -o OUT`."""

from __future__ import annotations

import json
import sys

from window.command import blender


def test_a_reconstruction_from_photographs_to_a_relit_picture(home, finished):
    done, out = finished.done, finished.out
    # so small a run may well fail its own quality check, and is whole all the same
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
        (["robir_scene", "render", empty], 6, "cannot be read"),
        (["robir_scene", "paint", empty], 2, "invalid choice"),
    ):
        done = blender(home, *words)
        assert done.returncode == code, (words, done.stderr)
        assert sentence in done.stderr
