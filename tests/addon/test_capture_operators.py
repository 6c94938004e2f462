# SPDX-License-Identifier: Apache-2.0
"""Capture and reconstruction by the installed extension's operators, with workers that are real."""

from __future__ import annotations

import json
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest
from addon.blenders import run
from capture.scene import AIM, cameras, shoot
from capture.writers import nerf_synthetic, nerfstudio
from PIL import Image

from robir.jobs.paths import JobPaths, read_json

pytestmark = pytest.mark.blender

HERE = Path(__file__).parent
SESSION = (HERE / "capture_session.py").read_text(encoding="utf-8")
ENGINE = [sys.executable, str(HERE / "tiny_engine.py")]
AWKWARD = 'it\'s a "capture" of Gänse 鵝'


@pytest.fixture(scope="module")
def shots():
    return [shoot(camera, samples=2) for camera in cameras(14)]


@pytest.fixture(scope="module")
def capture(shots, tmp_path_factory) -> Path:
    """Twelve photographs and two kept aside, in a place with an awkward name."""
    return nerf_synthetic(tmp_path_factory.mktemp("captures") / AWKWARD, shots, tests=2)


@pytest.fixture
def session(extension_zip, tmp_path):
    """Runs a part of the session in a fresh Blender."""

    def part(blender, name, *arguments):
        words = [str(word) for word in arguments]
        return run(
            blender, SESSION, name, str(extension_zip), ENGINE, *words, user=tmp_path / "user"
        )

    return part


def refused(answer, *words: str) -> bool:
    """Whether an operator said an error that holds some words."""
    return answer[0] == ["RAISED"] and all(word in answer[1] for word in words)


def check_look(answer, capture, shots):
    assert not answer["poll"]
    assert answer["chosen"] == answer["again"] == [["FINISHED"], ""]
    assert answer["recognised"] == "14 photographs with cameras (nerf-synthetic)"
    assert "error" not in answer["levels"]
    assert answer["is_same"], "a second look made more of everything"
    assert answer["may_reconstruct"]
    assert answer["default_folder"] == str(capture.with_name(f"{capture.name}_robir"))
    assert answer["is_as_before"] and answer["is_undone"]
    shown = {o["name"]: o for o in answer["objects"]}
    bounds = shown.pop("Bounds of the object")
    np.testing.assert_allclose(np.array(bounds["matrix"])[:3, 3], AIM, atol=0.15)
    assert 0.8 < bounds["size"] < 1.3
    seen = [o for o in shown.values() if o["type"] == "CAMERA"]
    assert len(seen) == len(shots) and len(shown) == 2 * len(shots)
    for camera in seen:
        photo = Path(camera["photo"])
        assert photo.is_file() and photo.is_relative_to(capture)
        shot = shots[int(photo.stem[2:]) + (12 if photo.parent.name == "test" else 0)]
        np.testing.assert_allclose(camera["matrix"], shot.camera.camera_to_world, atol=1e-5)
        small = shown[f"{camera['view']} photograph"]
        assert (small["parent"], small["picture"]) == (camera["name"], [48, 48])
        # it fills the frame that Blender draws for the camera
        corners = np.array(camera["frame"]) * camera["display_size"]
        width, depth = np.ptp(corners[:, 0]), -corners[0, 2]
        np.testing.assert_allclose(small["size"], width, rtol=1e-4)
        np.testing.assert_allclose(small["local"], [*corners[:, :2].mean(0), -depth], atol=1e-4)


def check_faults(answer, bad, missing):
    assert refused(answer["bad"], "no masks", "Masks")
    assert answer["bad_recognised"] == "" and not answer["may_reconstruct_bad"]
    # its cameras are there all the same, to place the box by
    assert len(answer["bad_shown"]) == 6 + 1 and "Where the cameras look" in answer["bad_shown"]
    np.testing.assert_allclose(answer["bad_box"][:3], AIM, atol=0.3)
    assert not answer["missing_shown"]
    level, text, cure = answer["bad_findings"][0]
    assert level == "error" and "no masks" in text and "--" not in cure
    assert refused(answer["missing"], "does not exist")
    assert refused(answer["no_folder"], "no folder")
    assert answer["told"]["error"] == answer["told"]["task"] == ""


def test_a_capture_is_looked_at_and_put_away(newest, session, capture, shots, tmp_path):
    bad, missing = nerfstudio(tmp_path / "bad", shots[:6]), tmp_path / "missing"
    shutil.rmtree(bad / "mattes")
    generator = np.random.default_rng(0)
    for path in sorted((bad / "images").iterdir()):  # nothing that masks could be guessed from
        noise = generator.integers(0, 255, (48, 48, 3), np.uint8)
        Image.fromarray(noise).save(path)
    plain = json.loads((bad / "transforms.json").read_text())
    for frame in plain["frames"]:
        del frame["mask_path"]
    (bad / "transforms.json").write_text(json.dumps(plain))
    answer = session(newest, "look", capture, bad, missing)
    check_look(answer, capture, shots)
    check_faults(answer, bad, missing)


def test_a_box_about_the_object_goes_to_the_engine(oldest, session, capture):
    answer = session(oldest, "box", capture)
    assert answer["without"] == answer["deleted"] == []
    assert answer["added"] == [["FINISHED"], ""] and answer["selected"] == ["Object box"]
    np.testing.assert_allclose(answer["first"][:3], AIM, atol=0.15)
    assert 1.6 < answer["first"][3] < 2.6, "as large as the bounds that are shown"
    # an empty of half side 1 at (1, 2, 3), sides doubled, trebled, kept, a quarter turn about z
    np.testing.assert_allclose(answer["moved"], [1, 2, 3, 6, 4, 2], atol=1e-5)
    # a mesh whose corners lie at 0 and 1, moved by (5, 0, 0)
    np.testing.assert_allclose(answer["mesh"], [5.5, 0.5, 0.5, 1, 1, 1], atol=1e-5)
    assert answer["words"] == ["--set", "capture.box=[5.5, 0.5, 0.5, 1.0, 1.0, 1.0]"]
    assert answer["looked"] == [["FINISHED"], ""] and answer["seen"] == answer["words"]


def test_a_missing_photograph_stops_nothing(own_blender, session, capture, shots, tmp_path):
    lacking = nerf_synthetic(tmp_path / AWKWARD, shots, tests=2)
    (lacking / "train/r_5.png").unlink()
    answer = session(own_blender, "lacking", lacking, capture)
    assert refused(answer["chosen"], "1 of 14", "press Leave Out")
    assert answer["codes"] == ["missing-images"]
    assert answer["left_out"] == answer["again"] == [["FINISHED"], ""]
    assert answer["recognised"] == "13 photographs with cameras (nerf-synthetic)"
    assert len(answer["photographs"]) == 13
    assert answer["one_less"] == "12 photographs with cameras (nerf-synthetic)"
    assert [used for _, used, _ in answer["kept"]].count(False) == 1
    name = answer["photographs"][0]
    assert [name, False, "left out"] in answer["kept"]
    assert "--skip-missing" in answer["words"]
    assert f'capture.leave_out=["{name}"]' in answer["words"]
    assert answer["other"] == [["FINISHED"], ""]
    assert "--skip-missing" not in answer["other_words"], "that was said of another capture"
    assert answer["other_words"][3] == str(capture.with_name(f"{capture.name}_robir"))
    assert answer["other_result"] == ""


def test_a_capture_in_millimetres_is_shown_at_a_size_to_work_with(own_blender, session, capture):
    answer = session(own_blender, "millimetres", capture)
    for name in ("plain", "large"):
        shown = answer[name]
        assert 0.8 < shown["radius"] < 1.3
        assert name == "plain" or max(map(abs, shown["centre"])) < 2.0
        assert shown["cube"] is False, "what Blender starts with hides the object"
        np.testing.assert_allclose(shown["distances"], answer["plain"]["distances"], rtol=0.3)
    np.testing.assert_allclose(answer["box"], answer["sphere"], rtol=1e-3)
    # the sides that no photograph shows, on bounds of radius one about (0, 0, 1)
    np.testing.assert_allclose(answer["missing"], [[0, 0, 2], [0.6, 0, 1.8]], atol=1e-5)
    np.testing.assert_allclose(answer["arrow"], [0, 0, -1], atol=1e-5)
    assert answer["cleared"] is True and answer["left"] == []


def test_tasks_are_followed_and_stopped(own_blender, session):
    answer = session(own_blender, "tasks", sys.executable)
    assert answer["lines"] == [
        {"progress": 0.5, "message": "half"},
        {"text": "Gänse"},
        {"message": "on"},
    ]
    assert answer["ends"] == [[7, 'no JSON\n["a list"]', ""], [130, "", ""]]
    assert (answer["spoken"]["fraction"], answer["spoken"]["message"]) == (0.5, "half")
    assert answer["silent"]["message"] == "", "only what comes of work is said after it"
    assert (answer["began"]["task"], answer["began"]["fraction"]) == ("install", 0.0)
    assert answer["stopping"]["message"] == "Stopping"
    assert answer["seconds"] < 300.0
    assert answer["last"]["task"] == ""
    assert "at work already" in answer["busy"][0]
    assert "absent cannot be run" in answer["busy"][1]


def test_a_script_reconstructs_and_imports(own_blender, session, capture, shots, tmp_path):
    other = nerf_synthetic(tmp_path / "other", shots[:8], tests=2)
    out = tmp_path / f"{AWKWARD} result"
    answer = session(own_blender, "reconstruct", capture, other, out)
    assert not answer["poll"]
    assert answer["done"] == answer["again"] == [["FINISHED"], ""]
    assert answer["is_same"], "the second import made more of everything"
    told = answer["told"]
    assert (told["result"], told["error"], told["task"], told["job"]) == (str(out), "", "", "")
    assert "RobIR capture" not in answer["collections"] and answer["collections"]
    assert answer["preview"] == [96, 48] and answer["serial"] >= 2
    assert refused(answer["other"], "holds the result of", "choose another result folder")
    assert answer["other_told"]["error_cure"] == "Choose another result folder"
    assert str(capture) in answer["recent"]
    assert answer["recent_out"] == str(out), "a chosen result folder is found again"
    # so small a run fails its own quality check, and is imported all the same
    run = read_json(JobPaths(out).run)
    assert (run["state"], run["exit_code"]) == ("done", 5)
