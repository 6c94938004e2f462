# SPDX-License-Identifier: Apache-2.0
"""What the user knows, told in the panel: a spot's paint, the sun, the tone curve."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from addon.blenders import run, sessions
from capture.scene import cameras, shoot
from capture.writers import nerf_synthetic
from evaluation import sphere_run

from robir.appearance.config import FAMILIES
from robir.config import RunConfig

pytestmark = pytest.mark.blender

HERE = Path(__file__).parent
ENGINE = [sys.executable, str(HERE / "tiny_engine.py")]
SESSION = sessions("capture_session", "known_session")
SHARES = np.array([0.5, 0.3, 0.2])


@pytest.fixture
def session(extension_zip, tmp_path):
    """Runs a part of the session in a fresh Blender."""

    def part(blender, name, *arguments):
        user = tmp_path / "user"
        return run(
            blender,
            sessions("capture_session", "known_session"),
            name,
            str(extension_zip),
            ENGINE,
            *arguments,
            user=user,
        )

    return part


@pytest.fixture(scope="module")
def captures(tmp_path_factory) -> tuple[str, str]:
    shots = [shoot(camera, samples=2) for camera in cameras(14)]
    folder = tmp_path_factory.mktemp("captures")
    return tuple(str(nerf_synthetic(folder / name, shots, tests=2)) for name in ("one", "other"))


def refused(answer, *words: str) -> bool:
    return answer[0] == ["RAISED"] and all(word in answer[1] for word in words)


def test_a_spot_is_found_on_a_result_that_was_moved(oldest, session, result):
    mesh = sphere_run.world_mesh()
    chosen = [100, 700, 1500]
    places = [(SHARES @ mesh.vertices[mesh.faces[face]]).tolist() for face in chosen]
    texels = [SHARES @ mesh.uvs[mesh.uv_faces[face]] for face in chosen]
    answer = session(oldest, "spots", str(result.root), places)
    assert refused(answer["early"], "Import a result first")
    for (said, texel, root), true in zip(answer["found"], texels, strict=True):
        assert said == [["FINISHED"], ""]
        np.testing.assert_allclose(texel, true, atol=1e-5)
        assert root == str(result.root)
    assert answer["near"] == [["FINISHED"], ""]
    assert refused(answer["far"], "3D cursor is not on", "Shift") and answer["kept"]
    assert refused(answer["hidden"], "unhide")
    assert refused(answer["bare"], "lacks the texture coordinates")
    assert answer["forgotten"] == [[["FINISHED"], ""], ""] and not answer["may_forget"]
    assert refused(answer["gone"], "import the result again")


def test_the_rendered_layer_of_a_stretched_mesh_of_quads_is_read(own_blender, session):
    places = [(-1.7, 0.2, 0.09), (0.25, 1.9, 0.675), (1.99, -1.99, 1.197), (0.6, 0.3, 9.78)]
    found = session(own_blender, "grid", places)
    true = [[0.5 + 0.2 * x, 0.4 - 0.1 * y] for x, y, _ in places]
    np.testing.assert_allclose(found, true, atol=1e-5)


def test_a_lamp_tells_the_sun_in_the_captures_frame(newest, session, result):
    answer = session(newest, "suns", str(result.root))
    assert not answer["poll"] and refused(answer["point"], "Select a Sun lamp")
    assert answer["taken"] == [["FINISHED"], ""]
    # tilted by 30 degrees about x: away from +z towards -y
    tilted = [0.0, -0.5, np.sqrt(0.75)]
    np.testing.assert_allclose(answer["plain"], tilted, atol=1e-6)
    np.testing.assert_allclose(answer["shown"], tilted, atol=1e-6)
    # what was the capture's -x is now the scene's -y
    np.testing.assert_allclose(answer["turned"], [-0.5, 0.0, np.sqrt(0.75)], atol=1e-6)
    np.testing.assert_allclose(answer["both turned"], tilted, atol=1e-6)
    assert answer["forgotten"] == [[["FINISHED"], ""], [0, 0, 0]] and not answer["may_forget"]


def test_what_is_known_goes_to_the_engine_and_to_no_other_capture(
    own_blender, session, result, captures
):
    answer = session(own_blender, "requests", str(result.root), *captures)
    assert "--set" not in answer["nothing"]
    assert answer["picked"] == [["FINISHED"], ""]
    words = [word for word in answer["words"] if word.startswith("appearance.")]
    told = ['families=["agx"]', "white_point=[0.25, 0.75, 0.5, 0.25, 1.0]", "sun=[0.0, 0.6, 0.8]"]
    assert words == [f"appearance.{item}" for item in told]
    places = [answer["words"].index(word) for word in words]
    assert all(answer["words"][place - 1] == "--set" for place in places)
    assert "--resume" in answer["words"] and "--defaults" in answer["words"]
    assert "was picked on" in answer["elsewhere"]
    assert answer["here"] == answer["picked again"] == ""
    assert answer["larger"] == ["capture.max_side=1600", "appearance.texture_size=4096"]
    usual = RunConfig()
    assert answer["usual"] == [usual.capture.max_side, usual.appearance.texture_size]
    assert "another shape" in answer["finer"] and "another shape" in answer["changed"]
    assert answer["refreshed"] == [["FINISHED"], ""]
    spot, sun, message = answer["after"]
    assert spot == "" and sun == pytest.approx(0.6) and "pick the spot" in message
    assert len(answer["same"]) == 3
    assert answer["other"] == [] and answer["colour"] == pytest.approx([0.18] * 3)


def test_every_tone_family_can_be_chosen(own_blender, session):
    assert session(own_blender, "curves") == ["auto", *FAMILIES]
