# SPDX-License-Identifier: Apache-2.0
"""What test_panels.py has done in one Blender: every panel in every state, and what came of it.

Runs inside Blender after the text of recording.py, whose names it uses.
"""

import json
import os
import shutil
import sys
import tempfile
import time
from importlib import import_module
from pathlib import Path

import bpy
from recording import Drawn, Fault, Recorder, classes_of  # taken out before it runs

MODULE = "bl_ext.user_default.robir"
TRIALS = 5
SENTENCE = "The engine stopped without saying why while it made the shape of the object"
PATH = "/somewhere/" + "very-long-name-" * 12


def main(archive, result):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.extensions.package_install_files(
        filepath=archive, repo="user_default", enable_on_install=True
    )
    # the engine's state may be looked at once a second: here it was looked at just now
    preferences = import_module(f"{MODULE}.preferences")
    preferences._FRESH_SECONDS = 600.0
    preferences.shown_engine_status(bpy.context)
    return {
        "states": {name: draw_everything(name, result) for name in STATES},
        "planted": {name: planted(draw) for name, draw in PLANTED.items()},
        "operators": operators(),
        "refusals": refusals(),
        "menus": menus(),
    }


def nothing(settings, state, result):
    pass


def chosen(settings, state, result):
    settings.capture = "/captures/wooden truck/"


def looking(settings, state, result):
    chosen(settings, state, result)
    state.task, state.fraction, state.message = "look", 0.3, "reading photograph 12 of 48"


def looked(settings, state, result):
    chosen(settings, state, result)
    state.looked_at = settings.capture
    state.recognised = "40 photographs with cameras (nerf-synthetic)"
    for level in ("note", "error", "warning"):
        finding = state.findings.add()
        finding.level = level
        finding.text = f"21 of 48 photographs are clipped on the object ({PATH})"
        finding.cure = "Photograph or render with less exposure" if level != "note" else ""
    bpy.data.collections.new("RobIR capture")


def lacking(settings, state, result):
    looked(settings, state, result)
    state.findings[1].code = "missing-images"
    state.findings[2].code, state.findings[2].files = "blurred", "r_1\nr_2"
    for name in ("r_1", "r_2", "r_3"):
        settings.photographs.add().name = name
    settings.photographs["r_3"].is_used = False


def undone(settings, state, result):
    faultless(settings, state, result)
    settings.capture = ""


def another(settings, state, result):
    looked(settings, state, result)
    settings.capture = "/captures/metal truck/"


def faultless(settings, state, result):
    looked(settings, state, result)
    state.findings.clear()


def started(settings, state, result):
    looked(settings, state, result)
    state.task, state.message, state.job = "reconstruct", "starting the engine", "/captures/out"


def running(settings, state, result):
    started(settings, state, result)
    state.stage, state.fraction, state.seconds_left = "geometry", 0.42, 5600.0
    growth = import_module(f"{MODULE}.work.growth")
    growth._refresh_icons(bpy.data.images.new("RobIR preview", 8, 4))


def stopped(settings, state, result):
    looked(settings, state, result)
    state.message = "Stopped; Reconstruct goes on from the last finished stage"


def failed(settings, state, result):
    looked(settings, state, result)
    state.error, state.error_cure = f"{SENTENCE} ({PATH})", "Reconstruct again; it goes on"


def offline(settings, state, result):
    engine = import_module(f"{MODULE}.operators.engine")
    state.error, state.error_cure = engine.OFFLINE, "Turn it on"


def refused(settings, state, result):
    try:
        bpy.ops.robir.install_engine()
    except RuntimeError:
        assert state.error


def done(settings, state, result):
    looked(settings, state, result)
    settings.result = result


def knowing(settings, state, result):
    done(settings, state, result)
    settings.spot_result, settings.spot_texel = result, (0.25, 0.5)
    settings.sun, settings.tone_curve = (0.0, 0.6, 0.8), "filmic"


def relit(settings, state, result):
    done(settings, state, result)
    bpy.ops.robir.import_result(directory=result)
    settings.light = "forest"


def pictured(settings, state, result):
    folder = Path(tempfile.mkdtemp())
    shutil.copytree(result, folder, dirs_exist_ok=True)
    (folder / "renders").mkdir(exist_ok=True)
    for light in ("recovered", "city", "forest"):
        image = bpy.data.images.new(light, 8, 8)
        image.filepath_raw = str(folder / "renders" / f"light_{light}.png")
        image.file_format = "PNG"
        image.save()
        bpy.data.images.remove(image)
    bpy.ops.robir.import_result(directory=str(folder))
    pictures = import_module(f"{MODULE}.relighting.lights").light_pictures(settings.result)
    assert set(pictures) == {"", "city", "forest"}, pictures


def doubtful(settings, state, result):
    folder = Path(tempfile.mkdtemp())
    report = json.loads((Path(result) / "report" / "report.json").read_text())
    report["light_level"] = [{"by": "all", "times": 1.0, "within": 1.8}]
    report["trust"] |= {"is_trusted": False, "doubts": ["the re-render reaches only 12.7 dB"]}
    verdict = {"word": "Doubtful", "reason": "it looks otherwise", "remedy": "look at the report"}
    report["trust"]["verdict"] = verdict
    (folder / "report").mkdir()
    (folder / "report" / "report.json").write_text(json.dumps(report))
    done(settings, state, str(folder))


def unreadable(settings, state, result):
    settings.result = f"{result}/nothing here"


def damaged(settings, state, result):
    folder = tempfile.mkdtemp()
    report = Path(folder) / "report" / "report.json"
    report.parent.mkdir()
    report.write_text('{"choices": {"tone curve": 3}}')
    settings.result = folder
    # what fails in an update of a property is only printed
    import_module(f"{MODULE}.result.summary").read_shown()


def filming(settings, state, result):
    done(settings, state, result)
    state.task, state.fraction, state.message = "turntable", 0.5, "frame 24 of 48"


def in_trouble(settings, state, result):
    failed(settings, state, result)
    for name in ("r_1", "r_2"):
        settings.photographs.add().name = name
    state.findings[0].level, state.findings[0].code = "warning", "coverage-gap"
    state.findings[1].code = "missing-images"
    state.findings[2].code, state.findings[2].files = "blurred", "r_1"
    bpy.data.collections.new("Not photographed")


def crowded(settings, state, result):
    relit(settings, state, result)
    filming(settings, state, result)
    state.error, state.error_cure = SENTENCE, "Press it again"


def installing(settings, state, result):
    state.task, state.fraction, state.message = "install", 0.1, "downloading torch"


def checking(settings, state, result):
    state.task, state.engine_text = "check_engine", "Not checked yet"


def engine_checked(settings, state, result):
    state.engine_ok, state.engine_text = True, "Processor, 2 cores, 7.8 GB free, torch 2.13"


STATES = {
    function.__name__: function
    for function in (
        nothing, chosen, looking, looked, lacking, faultless, undone, another, started, running,
        stopped, failed, offline, refused, done, knowing, relit, pictured, doubtful, unreadable,
        damaged, filming, in_trouble, crowded, installing, checking, engine_checked,
    )
}  # fmt: skip


def in_state(name, result):
    """Bring an empty file into a state."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=False)
    STATES[name](bpy.context.scene.robir, bpy.context.window_manager.robir, result)


def panels():
    """Our panels."""
    return classes_of(MODULE, bpy.types.Panel)


def draw_everything(state, result):
    """Every panel that polls, open and with closed parts: faults, texts, buttons, time, files."""
    in_state(state, result)
    answer = {"panels": [], "faults": [], "texts": [], "buttons": [], "wide": [], "files": []}
    for name, cls in panels().items():
        if hasattr(cls, "poll") and not cls.poll(bpy.context):
            continue
        answer["panels"].append(name)
        for is_open in (True, False):
            try:
                with FileWatch() as touched:
                    layout = Drawn(cls, is_open).draw_all(bpy.context)
            except Fault as fault:
                answer["faults"].append(f"{name}: {fault}")
                continue
            answer["texts"] += layout.texts()
            answer["buttons"] += layout.operators()
            answer["wide"] += layout.wide
            if not is_open and "DEFAULT_CLOSED" not in getattr(cls, "bl_options", ()):
                answer["controls"] = answer.get("controls", 0) + layout.controls()
                answer["at_once"] = answer.get("at_once", []) + layout.texts()
            answer["pictures"] = answer.get("pictures", 0) + layout.pictures()
            answer["files"] += touched
    answer["milliseconds"] = 1000.0 * min(seconds_to_draw() for _ in range(TRIALS))
    return answer


class Mute:
    """A layout that costs nothing, to time what is ours."""

    def __getattr__(self, name):
        return (lambda *_, **__: (Mute(), Mute())) if name == "panel" else lambda *_, **__: Mute()

    def __setattr__(self, name, value):
        pass


def seconds_to_draw():
    """Of one redraw of the whole tab: panels with their polls, and the buttons' polls."""
    drawings = [(cls, Drawn(cls)) for cls in panels().values()]
    buttons = [getattr(bpy.ops.robir, name) for name in dir(bpy.ops.robir)]
    begin = time.thread_time()  # others may use the machine at the same time
    for cls, drawn in drawings:
        drawn.layout = Mute()
        if not hasattr(cls, "poll") or cls.poll(bpy.context):
            drawn.draw_all(bpy.context)
    for button in buttons:
        button.poll()
    return time.thread_time() - begin


class FileWatch:
    """Lists the files that are opened, listed or looked at inside the block."""

    _list = None
    _looks = ("stat", "lstat", "listdir", "scandir")

    def __enter__(self):
        FileWatch._list = []
        self._kept = {name: getattr(os, name) for name in self._looks}
        for name, function in self._kept.items():
            setattr(os, name, self._noted(function))
        return FileWatch._list

    def __exit__(self, *_):
        FileWatch._list = None
        for name, function in self._kept.items():
            setattr(os, name, function)

    @staticmethod
    def _noted(function):
        def noted(path, *rest, **named):
            FileWatch.note(str(path))
            return function(path, *rest, **named)

        return noted

    @classmethod
    def note(cls, what):
        if cls._list is not None:
            cls._list.append(what)


sys.addaudithook(
    lambda event, arguments: (
        FileWatch.note(str(arguments[0]))
        if event in ("open", "subprocess.Popen", "socket.connect")
        else None
    )
)

PLANTED = {
    "operator": lambda layout: layout.operator("robir.fly"),
    "operator property": lambda layout: setattr(layout.operator("wm.save_mainfile"), "speed", 1),
    "menu operator": lambda layout: layout.operator_menu_enum("robir.fly", "light"),
    "menu property": lambda layout: layout.operator_menu_enum("wm.save_mainfile", "filepath"),
    "icon": lambda layout: layout.label(text="x", icon="BANANA"),
    "icon of an operator": lambda layout: layout.operator("wm.save_mainfile", icon="BANANA"),
    "property": lambda layout: layout.prop(bpy.context.scene.robir, "banana"),
    "function": lambda layout: layout.banana(text="x"),
    "parameter": lambda layout: layout.label(txt="x"),
    "missing parameter": lambda layout: layout.prop(bpy.context.scene.robir),
    "layout property": lambda layout: setattr(layout.row(), "banana", True),
    "layout choice": lambda layout: setattr(layout, "emboss", "BANANA"),
    "bar": lambda layout: layout.progress(factor=0.5, type="BANANA"),
    "menu": lambda layout: layout.menu("ROBIR_MT_banana"),
    "popover": lambda layout: layout.popover("ROBIR_PT_banana"),
    "text": lambda layout: layout.label(text=3),
}


def planted(draw):
    """What the recorder says about a drawing that has a fault in it."""
    try:
        draw(Recorder())
    except Fault as fault:
        return str(fault)
    return "nothing"


def operators():
    """What Blender knows of each of our operators."""
    known = {}
    for name in dir(bpy.ops.robir):
        rna = getattr(bpy.ops.robir, name).get_rna_type()
        options = sorted(getattr(bpy.ops.robir, name).bl_options)
        known[name] = {"label": rna.name, "about": rna.description, "options": options}
    return known


def refusals():
    """What each operator says while there is nothing to work with, or something at work."""
    said = {}
    for state in ("nothing", "started"):
        in_state(state, "")
        said[state] = {}
        for name in dir(bpy.ops.robir):
            operator = getattr(bpy.ops.robir, name)
            if not operator.poll():
                try:
                    operator()
                except RuntimeError as fault:
                    said[state][name] = str(fault).partition("poll()")[2].strip()
    return said


def menus():
    """Operators that Blender's search finds by our menu, and whether all of it can be drawn."""
    in_state("nothing", "")
    (cls,) = [c for n, c in classes_of(MODULE, bpy.types.Menu).items() if n.endswith("commands")]
    found = {"commands": Drawn(cls).draw_all(bpy.context).operators()}
    for parent in ("VIEW3D_MT_view", "TOPBAR_MT_file_import"):
        drawn = Drawn(getattr(bpy.types, parent))
        ours = [f for f in drawn._cls.draw._draw_funcs if f.__module__.startswith(MODULE)]
        for function in ours:
            function(drawn, bpy.context)
        found[parent] = [
            given.get("menu", given.get("operator")) for _, given in drawn.layout.calls if given
        ]
    return found
