# SPDX-License-Identifier: Apache-2.0
"""De-light by the installed extension: the real worker, the user's object, its new material."""

from __future__ import annotations

import sys
import tomllib
from pathlib import Path

import pytest
from addon.blenders import run, sessions
from capture.scene import BALL, BOX_HIGH, BOX_LOW, CENTRE, cameras, shoot
from capture.writers import nerf_synthetic

from robir.jobs.paths import JobPaths, read_json

pytestmark = [pytest.mark.blender, pytest.mark.slow]

HERE = Path(__file__).parent
ENGINE = [sys.executable, str(HERE / "tiny_engine.py")]
SESSION = sessions("capture_session", "delight_session")


def test_an_object_gets_a_material_beside_its_own(own_blender, extension_zip, tmp_path):
    shots = [shoot(camera, samples=2) for camera in cameras(14)]
    capture = nerf_synthetic(tmp_path / "captures" / "a figure", shots, tests=2)
    ball, box = [list(CENTRE), BALL], [list(CENTRE + BOX_LOW), list(CENTRE + BOX_HIGH)]
    answer = run(
        own_blender, SESSION, "delight", str(extension_zip), ENGINE, str(capture), ball, box,
        user=tmp_path / "user",
    )  # fmt: skip
    assert not answer["poll"] and answer["may"]
    assert answer["done"] == answer["again"] == [["FINISHED"], ""], answer["told"]
    slots, used, worlds = answer["before"]
    assert (slots, used) == (["Baked by the sun"], [0])
    assert answer["after"] == [["Baked by the sun", "Figure de-lit"], [1], worlds + 1]
    assert answer["after_again"] == answer["after"], "the second time made more of everything"
    assert set(answer["remembered"]) == {0}
    root = Path(answer["told"]["result"])
    assert root.parent == capture.parent
    said, texel, true, elsewhere = answer["spot"]
    assert said == [["FINISHED"], ""] and "was picked on" in elsewhere
    assert texel == pytest.approx(true, abs=2e-3), "a quad is two triangles, its middle near both"
    white = tomllib.loads(JobPaths(root).config.read_text(encoding="utf-8"))["appearance"]
    assert white["white_point"][:2] == pytest.approx(texel, abs=1e-6)
    assert answer["images"][0] == str(JobPaths(root).textures / "albedo.png")
    assert answer["world"] == root.name
    metrics = read_json(JobPaths(root).manifest("geometry"))["metrics"]
    assert (metrics["surface"], metrics["layout"]) == ("given", "own")
    assert metrics["outline_agreement"] > 0.95
    said, plain = [["FINISHED"], ""], ["Base Color", "Roughness"]
    with_metal = ["Base Color", "Metallic", "Roughness"]
    assert answer["fed"] == [[said, plain], [said, with_metal], [said, plain]]
    assert answer["undone"] == answer["before"]
    assert answer["bare"] == [["FINISHED"], ""]
    assert answer["bare_after"][0] == ["Baked by the sun"], "no layout: its own stays as it is"
    assert "a_figure" in answer["objects"], answer["objects"]
