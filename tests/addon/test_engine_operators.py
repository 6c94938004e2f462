# SPDX-License-Identifier: Apache-2.0
"""The engine's operators in real Blenders: permission, install, check, remove, others' Pythons."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import pytest
from addon.blenders import MODULE, run
from addon.wheelhouse import stand_ins

from robir_addon.operators import shared

pytestmark = pytest.mark.blender

COMMON = f"""
import os
import sys

import bpy

MODULE = {MODULE!r}


def start(archive):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.extensions.package_install_files(
        filepath=archive, repo="user_default", enable_on_install=True)
    return bpy.context.preferences.addons[MODULE].preferences, bpy.context.window_manager.robir


def module(name):
    return sys.modules[MODULE + "." + name]


def press(name):
    try:
        return list(getattr(bpy.ops.robir, name)())
    except RuntimeError as error:
        return str(error)


def files(folder):
    return sorted(
        (os.path.join(place, name), os.stat(os.path.join(place, name)).st_size)
        for place, _, names in os.walk(folder) for name in names if not name.endswith(".pyc"))
"""

LIFE = """
def main(archive, wheels, site_packages):
    preferences, state = start(archive)
    before = files(site_packages)
    place, answer = module("preferences").managed_place(), {}
    answer["states"] = [module("preferences").engine_status(bpy.context).state]
    answer["without permission"] = press("install_engine"), state.error, state.error_cure
    answer["made without permission"] = place.root.exists()
    answer["nothing to check"] = press("check_engine")
    answer["nothing to remove"] = press("remove_engine")
    preferences.wheels = wheels + "?"
    answer["no such folder"] = press("install_engine")
    preferences.wheels = wheels
    answer["install"] = press("install_engine"), state.error, state.task
    answer["states"].append(module("preferences").engine_status(bpy.context).state)
    answer["text"] = state.engine_text
    answer["python"] = str(module("preferences").engine_python(bpy.context))
    answer["again"] = press("install_engine")
    answer["check"] = press("check_engine"), state.engine_ok, state.error_cure
    preferences.torch_build = "CUDA"
    answer["states"].append(module("preferences").engine_status(bpy.context).state)
    answer["goes"] = module("operators.engine").what_goes()
    answer["remove"] = press("remove_engine"), place.root.exists()
    answer["states"].append(module("preferences").engine_status(bpy.context).state)
    answer["same"] = files(site_packages) == before
    return answer
"""


def test_life_of_an_engine_that_robir_makes(own_blender, extension_zip, tmp_path):
    """Of stand-ins for torch and the others: it installs, and its check says what is wrong."""
    user, wheels = tmp_path / 'a user\'s "Blender" é', stand_ins(tmp_path / "the wheels' folder")
    places = (str(extension_zip), str(wheels), str(own_blender.site_packages))
    answer = run(own_blender, COMMON + LIFE, *places, user=user)
    assert answer["states"] == ["missing", "ready", "outdated", "missing"]
    report, error, cure = answer["without permission"]
    assert error == "Blender is not allowed to go online"
    assert "Allow Online Access in Preferences > System" in cure
    assert error in report
    assert not answer["made without permission"]
    assert "No engine is installed" in answer["nothing to check"]
    assert "no engine to remove" in answer["nothing to remove"]
    assert "does not exist" in answer["no such folder"]
    assert answer["install"] == [["FINISHED"], "", ""]
    assert "torch 2.13.0+cpu" in answer["text"]
    root = user / "extensions/.user/user_default/robir/engine"
    assert Path(answer["python"]).is_relative_to(root)
    assert "is installed" in answer["again"]
    report, ok, cure = answer["check"]
    assert "missing or broken" in report
    assert not ok
    assert "nstall the engine again" in cure
    assert answer["goes"].endswith(str(root))
    assert " GB in " in answer["goes"]
    assert answer["remove"] == [["FINISHED"], False]
    assert answer["same"]


REFUSED = """
def main(archive):
    preferences, state = start(archive)
    system, answer, said = bpy.context.preferences.system, {}, []

    class Clicked(module("operators.shared").WaitingOperator):
        # without a window Blender takes every click for a script's call
        begin = module("operators.engine").ROBIR_OT_allow_online.begin
        report = lambda self, kind, sentence: said.append(sentence)

    for engine in ("MANAGED", "EXISTING"):
        preferences.engine, preferences.wheels = engine, "/no wheels"
        system.use_online_access = False
        said.clear()
        came = list(Clicked().invoke(bpy.context, None))
        allowed = system.use_online_access
        answer[engine] = came, list(said), state.error, state.error_cure, allowed
    return answer
"""


def test_permission_is_given_where_the_installation_is_refused(
    own_blender, extension_zip, tmp_path
):
    """By what the button *Allow Online Access and Install* runs."""
    answer = run(own_blender, COMMON + REFUSED, str(extension_zip), user=tmp_path)
    for engine, sentence, cure in (
        ("MANAGED", "The folder of wheels /no wheels does not exist", "Choose another"),
        ("EXISTING", "An existing environment is chosen in the preferences", ""),
    ):
        came, (report,), error, error_cure, is_allowed = answer[engine]
        assert came == ["CANCELLED"]
        assert is_allowed
        assert error == sentence
        assert error_cure.startswith(cure)
        assert report.startswith(sentence), "no words of Blender's, no traceback"


def area(kind: str, tab: str) -> SimpleNamespace:
    region = SimpleNamespace(type="UI", width=280, active_panel_category=tab)
    return SimpleNamespace(type=kind, regions=[region])


@pytest.mark.parametrize(
    ("kind", "tab", "is_reported"),
    [("VIEW_3D", "RobIR", False), ("VIEW_3D", "Item", True), ("PREFERENCES", "", False)],
)
def test_a_refusal_pops_up_only_where_nothing_else_says_it(monkeypatch, kind, tab, is_reported):
    monkeypatch.setattr(shared, "bpy", SimpleNamespace(app=SimpleNamespace(background=False)))
    said, clicked = [], area(kind, tab)
    operator = SimpleNamespace(report=lambda _kind, sentence: said.append(sentence))
    context = SimpleNamespace(screen=SimpleNamespace(areas=[clicked]), area=clicked)
    shared.refused(operator, context, "No")
    assert said == ["No"] * is_reported


DRAWN = """
class Shown:
    # the preferences themselves to whoever asks, but with a layout that writes down what is drawn
    __class__ = property(lambda self: type(self._preferences))

    def __init__(self, preferences):
        self._preferences, self.layout = preferences, Recorder()

    def __getattr__(self, name):
        return getattr(self._preferences, name)


def main(archive):
    preferences, state = start(archive)
    said = {"pressed": press("install_engine"), "error": state.error}
    said["made"] = module("preferences").managed_place().root.exists()
    for engine in ("MANAGED", "EXISTING"):
        preferences.engine = engine
        for task in ("", "install", "failed"):
            state.task, state.message, state.engine_text = task, "torch, 3 of 9 MB", "All is well"
            state.error, state.error_cure, state.engine_error = "", "", "Nobody offers it"
            if task == "failed":
                state.task, state.error, state.error_cure = "", "Nobody offers it", "Choose another"
            shown = Shown(preferences)
            type(preferences).draw(shown, bpy.context)
            said[engine + task] = shown.layout.texts(), shown.layout.operators()
    return said
"""


def test_permission_and_preferences_in_every_blender(blender, extension_zip, tmp_path):
    recording = (Path(__file__).parent / "recording.py").read_text(encoding="utf-8")
    said = run(blender, recording + COMMON + DRAWN, str(extension_zip), user=tmp_path)
    assert said["error"] == "Blender is not allowed to go online"
    assert "Allow Online Access" in said["pressed"]
    assert not said["made"]
    texts, buttons = said["MANAGED"]
    assert {"No engine is installed", "Press Install Engine", "All is well"} <= set(texts)
    assert buttons == ["robir.check_engine", "robir.install_engine", "robir.remove_engine"]
    texts, buttons = said["MANAGEDinstall"]
    assert "torch, 3 of 9 MB" in texts
    assert buttons[0] == "robir.cancel_reconstruct"
    texts, _ = said["MANAGEDfailed"]
    assert {"Nobody offers it", "Choose another"} <= set(texts)
    assert not {"Press Install Engine", "All is well"} & set(texts), "that would contradict it"
    texts, buttons = said["EXISTING"]
    assert "No existing environment is chosen" in texts
    assert buttons == ["robir.check_engine"]
