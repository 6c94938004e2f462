# SPDX-License-Identifier: Apache-2.0
"""Every panel of the installed extension, in every state, on a layout that records."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from addon.blenders import VERSIONS, find_blender, run
from addon.finished import make_result

pytestmark = pytest.mark.blender

HERE = Path(__file__).parent
# operators that are of no use by themselves: no menu has them
INTERNAL = {"drop_capture", "drop_from_batch", "prefer_in_batch"}


def script(session: str) -> str:
    """The recorder and a session as one text, for nothing of the checkout is importable there."""
    recorder = (HERE / "recording.py").read_text(encoding="utf-8")
    lines = (HERE / session).read_text(encoding="utf-8").splitlines()
    return "\n".join([recorder, *(line for line in lines if not line.startswith("from recording"))])


@pytest.fixture(scope="session")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_result(tmp_path_factory.mktemp("finished") / "a 'result' über all").root


@pytest.fixture(scope="module", params=(VERSIONS[0], VERSIONS[-1]))
def seen(
    request: pytest.FixtureRequest,
    extension_zip: Path,
    finished: Path,
    tmp_path_factory: pytest.TempPathFactory,
) -> dict[str, Any]:
    """What a session in one Blender answered."""
    blender = find_blender(request.param)
    if blender is None:
        pytest.skip(f"no Blender {request.param} on this machine; make blenders fetches it")
    user = tmp_path_factory.mktemp("user")
    return run(blender, script("panel_session.py"), str(extension_zip), str(finished), user=user)


def test_every_panel_can_be_drawn_in_every_state(seen):
    faults = {state: found["faults"] for state, found in seen["states"].items() if found["faults"]}
    assert not faults


def test_each_panel_appears_in_its_state(seen):
    always = {"capture", "engine"}
    more = {
        "looked": {"reconstruct"},
        "failed": {"notice"},
        "stopped": {"notice"},
        "done": {"result", "relight", "export"},
        "chosen": {"known"},
    }
    for state, found in seen["states"].items():
        names = {name.removeprefix("ROBIR_PT_") for name in found["panels"]}
        assert always <= names, state
        assert names >= more.get(state, set()), state
    for state, absent in (
        ("nothing", "relight"),
        ("nothing", "known"),
        ("running", "notice"),
    ):
        assert f"ROBIR_PT_{absent}" not in seen["states"][state]["panels"]


def test_few_controls_are_seen_until_something_is_unfolded(seen):
    controls = {state: found["controls"] for state, found in seen["states"].items()}
    assert max(controls.values()) <= 15, controls
    assert min(controls[state] for state in ("in_trouble", "crowded")) > 12, "the worst are tried"


def test_a_refusal_is_said_once_where_one_looks(seen):
    for state, sentence in (
        ("refused", "Blender is not allowed to go online"),
        ("failed", "The engine stopped without saying why"),
        ("crowded", "The engine stopped without saying why"),
    ):
        assert " ".join(seen["states"][state]["at_once"]).count(sentence) == 1, state


def test_what_matters_is_said(seen):
    def said(state):
        return " ".join(seen["states"][state]["texts"])

    assert "wooden truck" in said("chosen")
    assert "reading photograph 12 of 48" in said("looking")
    assert "40 photographs with cameras (nerf-synthetic)" in said("looked")
    assert "less exposure" in said("looked")
    assert "No faults found" in said("faultless")
    assert "No faults found" not in said("undone"), "undone, nothing is known of any capture"
    assert "less exposure" not in said("another"), "what was found of one capture is no other's"
    assert "Photographs (2 of 3)" in said("lacking")
    assert seen["states"]["lacking"]["buttons"].count("robir.leave_out") == 4  # two, drawn twice
    running = said("running")
    for words in ("42 %", "Shape", "1 h 33 min left"):
        assert words in running
    assert "dB" not in running
    # open and closed: a photograph and what is known of it
    assert [seen["states"][state].get("pictures") for state in ("started", "running")] == [0, 4]
    assert "Reconstruct again; it goes on" in said("failed")
    assert "goes on from the last finished stage" in said("stopped")
    for words in ("The colour of the dot", "The sun stood 53\N{DEGREE SIGN} high", "shape stays"):
        assert words in said("knowing")
    assert not any(words in said("chosen") for words in ("colour of the dot", "sun stood", "stays"))
    for words in ("held-out", "triangles", "Good"):
        assert words in said("done")
    assert "Doubtful It looks otherwise. Look at the report Details" in said("doubtful")
    assert "the re-render reaches only 12.7 dB" in said("doubtful")
    assert "Doubtful" not in said("done")
    # among the facts and, open and closed, where it can be settled
    assert said("doubtful").count("may be 1.8 times too bright or dark") == 3
    assert "too bright" not in said("done")
    for state in ("unreadable", "damaged"):
        assert "Details" not in said(state)
    assert "frame 24 of 48" in said("filming")
    assert "downloading torch" in said("installing")
    assert "7.8 GB free" in said("engine_checked")


def test_the_button_that_is_needed_is_there(seen):
    needed = {
        "nothing": "choose_capture",
        "looked": "reconstruct",
        "running": "cancel_reconstruct",
        "failed": "copy_report",
        "stopped": "dismiss",
        "offline": "allow_online",
        "done": "into_photograph",
        "chosen": "pick_spot",
        "knowing": "forget_sun",
        "pictured": "export_glb",
        "installing": "cancel_reconstruct",
        "unreadable": "import_result",
    }
    for state, name in needed.items():
        assert f"robir.{name}" in seen["states"][state]["buttons"], state
    assert "robir.reconstruct" not in seen["states"]["running"]["buttons"]


def test_text_fits_a_narrow_sidebar(seen):
    assert not {state: found["wide"] for state, found in seen["states"].items() if found["wide"]}


def test_drawing_touches_no_file_and_is_fast(seen):
    assert not {state: found["files"] for state, found in seen["states"].items() if found["files"]}
    slowest = max(found["milliseconds"] for found in seen["states"].values())
    assert slowest < 5.0


def test_the_recorder_notices_what_does_not_exist(seen):
    """Without this, the tests above would prove nothing."""
    for fault, said in seen["planted"].items():
        assert said != "nothing", fault
    for fault in ("operator", "icon", "property", "menu", "popover", "function", "bar"):
        assert any(word in seen["planted"][fault] for word in ("fly", "banana", "BANANA"))


def test_every_operator_says_what_it_does(seen):
    for name, known in seen["operators"].items():
        assert known["label"], name
        assert len(known["about"].split()) >= 3, name
        assert not known["about"].endswith("."), name


def test_every_operator_is_found_by_the_search(seen):
    listed = {name.removeprefix("robir.") for name in seen["menus"]["commands"]}
    assert listed == set(seen["operators"]) - INTERNAL
    assert "ROBIR_MT_commands" in seen["menus"]["VIEW3D_MT_view"]
    assert "robir.import_result" in seen["menus"]["TOPBAR_MT_file_import"]
    for name in listed:
        assert "INTERNAL" not in seen["operators"][name]["options"], name


def test_what_changes_the_file_can_be_undone(seen):
    looks_only = {
        "add_library", "allow_online", "cancel_reconstruct",
        "check_engine", "copy_report", "dismiss", "drop_from_batch", "export_game", "export_glb",
        "export_textures", "export_usd", "install_engine", "open_report", "picture_lights",
        "prefer_in_batch", "remove_engine", "run_batch", "stop_batch", "turntable",
    }  # fmt: skip
    undone = {name for name, known in seen["operators"].items() if "UNDO" in known["options"]}
    assert undone == set(seen["operators"]) - looks_only


def test_who_refuses_says_why(seen):
    refused = seen["refusals"]
    for state, said in refused.items():
        for name, words in said.items():
            assert len(words.split()) >= 3, (state, name, words)
            assert "context is incorrect" not in words, (state, name)
    assert {"reconstruct", "use_environment", "export_glb"} <= set(refused["nothing"])
    assert {"reconstruct", "look_at_capture"} <= set(refused["started"])
