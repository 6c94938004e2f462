# SPDX-License-Identifier: Apache-2.0
"""The sample that comes with the extension, taken by its button."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from addon.blenders import run

pytestmark = pytest.mark.blender

HERE = Path(__file__).parent
SESSION = (HERE / "capture_session.py").read_text(encoding="utf-8")
ENGINE = [sys.executable, str(HERE / "tiny_engine.py")]

SAMPLE = """


def sample():
    answer = {"poll": bpy.ops.robir.try_sample.poll()}
    answer["tried"] = attempt(bpy.ops.robir.try_sample)
    answer["recognised"] = state().recognised
    answer["faults"] = [f.text for f in state().findings if f.level != "note"]
    laid_out = Path(settings().capture)
    answer["place"] = str(laid_out)
    answer["result"] = str(module("work.worker").result_folder(settings()))
    (laid_out / "mark").touch()
    attempt(bpy.ops.robir.clear_capture)
    answer["again"] = attempt(bpy.ops.robir.try_sample)
    answer["is_kept"] = (Path(settings().capture) / "mark").exists()
    answer["beside"] = sorted(child.name for child in laid_out.parent.iterdir())
    return answer
"""


def test_the_sample_needs_no_capture_and_is_laid_out_once(own_blender, extension_zip, tmp_path):
    """In one Blender: every other looks at a capture in test_capture_operators.py."""
    user = tmp_path / "user"
    answer = run(own_blender, SESSION + SAMPLE, "sample", str(extension_zip), ENGINE, user=user)
    assert answer["poll"] and answer["tried"] == answer["again"] == [["FINISHED"], ""]
    assert answer["recognised"] == "48 photographs, NeRF-synthetic"
    assert not answer["faults"]
    place = Path(answer["place"])
    assert place.is_relative_to(user) and place.name == "truck"
    assert answer["result"] == str(place.with_name("truck_robir"))
    assert answer["is_kept"] and answer["beside"] == ["truck"]
