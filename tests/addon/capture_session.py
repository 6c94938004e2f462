# SPDX-License-Identifier: Apache-2.0
"""What test_capture_operators.py has done in a Blender without a window.

There no timer fires, so what a window would do by itself is done by `pulse`, step for step.
"""

import os
import time
from importlib import import_module
from pathlib import Path

import bpy

MODULE = "bl_ext.user_default.robir"


def main(part, archive, engine, *arguments):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.extensions.package_install_files(
        filepath=archive, repo="user_default", enable_on_install=True
    )
    preferences = bpy.context.preferences.addons[MODULE].preferences
    preferences.engine, preferences.python = "EXISTING", engine[0]
    for name in ("capture", "reconstruct"):
        module("operators." + name).program = lambda python: [str(python), "-P", engine[1]]
    return globals()[part](*arguments)


def module(name):
    return import_module(f"{MODULE}.{name}")


def settings():
    return bpy.context.scene.robir


def state():
    return bpy.context.window_manager.robir


def told():
    """All that a panel could show."""
    names = ("task", "fraction", "stage", "message", "job", "error", "error_cure")
    return {name: getattr(state(), name) for name in names} | {"result": settings().result}


def pulse(is_enough, seconds=300.0):
    """Let the timer's work be done until something has come of it."""
    end = time.monotonic() + seconds
    while not is_enough():
        assert time.monotonic() < end, told()
        module("work.monitor")._pulse()
        time.sleep(0.02)


def attempt(operator, **values):
    """Result of an operator, and what it said where it reported an error."""
    try:
        return list(operator(**values)), ""
    except RuntimeError as fault:
        return ["RAISED"], str(fault)


def counts():
    kinds = ("objects", "cameras", "images", "collections")
    return {kind: len(getattr(bpy.data, kind)) for kind in kinds}


def look(capture, bad, missing):
    """Look at a good, a bad and a missing capture, twice at the good one, and clear it."""
    own = bpy.data.objects.new("the user's", None)
    bpy.context.scene.collection.objects.link(own)
    before = counts()
    answer = {"poll": bpy.ops.robir.look_at_capture.poll()}
    answer["chosen"] = attempt(bpy.ops.robir.choose_capture, directory=capture + os.sep)
    answer["recognised"] = state().recognised
    answer["levels"] = [finding.level for finding in state().findings]
    answer["objects"] = [describe(o) for o in bpy.data.collections["RobIR capture"].objects]
    first = counts()
    answer["again"] = attempt(bpy.ops.robir.look_at_capture)
    answer["is_same"] = counts() == first
    answer["may_reconstruct"] = bpy.ops.robir.reconstruct.poll()
    answer["bad"] = attempt(bpy.ops.robir.choose_capture, directory=bad)
    answer["bad_findings"] = [(f.level, f.text, f.cure) for f in state().findings]
    answer["bad_recognised"] = state().recognised
    shown = bpy.data.collections["RobIR capture"].objects
    answer["bad_shown"] = sorted(o.name for o in shown if o.type == "CAMERA" or not o.parent)
    attempt(bpy.ops.robir.add_box)
    box_shown = settings().box
    answer["bad_box"] = list(module("work.worker").box_of(settings()))
    bpy.data.objects.remove(box_shown)
    answer["may_reconstruct_bad"] = bpy.ops.robir.reconstruct.poll()
    settings().capture = missing
    answer["missing"] = attempt(bpy.ops.robir.look_at_capture)
    answer["missing_shown"] = "RobIR capture" in bpy.data.collections
    settings().capture = capture + os.sep
    answer["default_folder"] = str(module("work.worker").result_folder(settings()))
    answer["no_folder"] = attempt(bpy.ops.robir.choose_capture, directory=missing)
    attempt(bpy.ops.robir.choose_capture, directory=capture)
    bpy.ops.wm.save_as_mainfile(filepath=str(Path(capture).with_name("look.blend")))
    bpy.ops.ed.undo_push(message="as a click would")
    answer["cleared"] = attempt(bpy.ops.robir.clear_capture)
    answer["is_as_before"] = counts() == before and settings().capture == ""
    answer["told"] = told()
    bpy.ops.ed.undo_push(message="as a click would")
    bpy.ops.ed.undo()
    answer["is_undone"] = counts() == first and settings().capture == capture
    return answer


def describe(shown):
    """Where an object is, and for a camera what it projects and shows."""
    facts = {
        "name": shown.name,
        "type": shown.type,
        "matrix": [list(r) for r in shown.matrix_world],
    }
    if shown.type == "EMPTY":
        facts["size"] = shown.empty_display_size
        facts["picture"] = list(shown.data.size) if shown.data else None
        facts["parent"] = shown.parent.name if shown.parent else None
        facts["local"] = list(shown.matrix_local.translation)
    if shown.type == "CAMERA":
        lens = shown.data
        facts["view"] = shown["robir_view"]
        facts["frame"] = [list(corner) for corner in lens.view_frame(scene=None)]
        facts["lens"] = [lens.lens, lens.sensor_width, lens.shift_x, lens.shift_y]
        facts["display_size"] = lens.display_size
        facts["photo"] = lens.background_images[0].image.filepath
    return facts


def box(capture):
    """The box about the object: none, as added, moved, a mesh in its place, deleted."""
    worker, look = module("work.worker"), module("operators.capture")
    bpy.ops.robir.choose_capture(directory=capture)
    answer = {"without": list(worker.request_of(settings()).box)}
    answer["added"] = attempt(bpy.ops.robir.add_box)
    answer["selected"] = [o.name for o in bpy.context.selected_objects]
    answer["first"] = worker.box_of(settings())
    shown = settings().box
    shown.empty_display_size, shown.location = 1.0, (1, 2, 3)
    shown.scale, shown.rotation_euler = (2, 3, 1), (0, 0, 1.5707963267948966)
    answer["moved"] = worker.request_of(settings()).box
    bpy.data.objects.remove(shown)
    answer["deleted"] = list(worker.box_of(settings()))
    mesh = bpy.data.meshes.new("unit")
    mesh.from_pydata([(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)], [], [(0, 1, 2), (0, 1, 3)])
    settings().box = own = bpy.data.objects.new("own", mesh)
    own.location = (5, 0, 0)
    answer["deleted"] += worker.box_of(settings())  # never was in the scene
    bpy.context.scene.collection.objects.link(own)
    answer["mesh"] = worker.box_of(settings())
    words = worker.request_of(settings()).words()
    answer["words"] = words[words.index("--set") :][:2]
    said = []
    run = module("work.monitor").wait_task
    look.monitor.wait_task = lambda name, command, *rest: (
        said.extend(command) or run(name, command, *rest)
    )
    answer["looked"] = attempt(bpy.ops.robir.look_at_capture)
    look.monitor.wait_task = run
    answer["seen"] = said[said.index("--set") :][:2]
    return answer


def reconstruct(capture, other, out):
    """The whole way as a script goes it, again, and where it cannot go on."""
    answer = {"poll": bpy.ops.robir.reconstruct.poll()}
    bpy.ops.robir.choose_capture(directory=capture)
    settings().out = out
    answer["done"] = attempt(bpy.ops.robir.reconstruct)
    answer["told"] = told()
    answer["collections"] = [c.name for c in bpy.data.collections]
    answer["preview"] = list(bpy.data.images["RobIR preview"].size)
    answer["serial"] = state().preview_serial
    first = counts()
    answer["again"] = attempt(bpy.ops.robir.reconstruct)
    answer["is_same"] = counts() == first
    settings().capture = other
    answer["other"] = attempt(bpy.ops.robir.reconstruct)
    answer["other_told"] = told()
    recent = module("capture.photographs")
    recent.unregister()
    recent.register()  # as in the next Blender
    answer["recent"] = recent.recent_captures()
    settings().capture = ""
    attempt(bpy.ops.robir.choose_capture, directory=capture)
    answer["recent_out"] = settings().out
    return answer


def lacking(capture, other):
    """A capture with a missing photograph: left out, one more left out, another capture."""
    answer = {"chosen": attempt(bpy.ops.robir.choose_capture, directory=capture)}
    answer["codes"] = [f.code for f in state().findings if f.level == "error"]
    answer["left_out"] = attempt(bpy.ops.robir.leave_out, finding=0)
    answer["recognised"] = state().recognised
    answer["photographs"] = [p.name for p in settings().photographs]
    settings().photographs[0].is_used = False
    answer["again"] = attempt(bpy.ops.robir.look_at_capture)
    answer["one_less"] = state().recognised
    answer["kept"] = [[p.name, p.is_used, p.reason] for p in settings().photographs]
    answer["words"] = module("work.worker").request_of(settings()).words()
    settings().out = settings().result = other + "_elsewhere"
    answer["other"] = attempt(bpy.ops.robir.choose_capture, directory=other)
    words = module("work.worker").request_of(settings()).words()
    answer["other_words"], answer["other_result"] = words, settings().result
    return answer


def millimetres(capture):
    """A capture as it is, and as if its unit were a 240th and its origin far off."""
    bpy.ops.wm.read_homefile(use_empty=False, use_factory_startup=True)
    look, answer, taken = module("operators.capture"), {}, []
    original = look._Look.take

    def take(self, event):
        original(self, event)
        taken.append(event)

    look._Look.take = take
    attempt(bpy.ops.robir.choose_capture, directory=capture)
    facts = next(event for event in taken if "accepted" in event)
    answer["plain"] = seen_bounds()
    for view in facts["cameras"]:
        for row in view["camera_to_world"][:3]:
            row[3] = row[3] * 240.0 / facts["radius"] + 795.0
    middle = [c * 240.0 / facts["radius"] + 795.0 for c in facts["centre"]]
    facts |= {"centre": middle, "radius": 240.0}
    gap = {"missing": [[0, 0, 1], [0.6, 0, 0.8]], "gap_direction": [0, 0, 1]}
    facts["findings"] = [{"code": "coverage-gap", "numbers": gap}]
    list(module("capture.viewport").show_capture(bpy.context.scene, facts))
    answer["large"] = seen_bounds()
    shown = bpy.data.collections["Not photographed"].objects
    patches = shown["Not photographed"].data.polygons
    answer["missing"] = [list(patch.center) for patch in patches]
    answer["arrow"] = list(shown["Photograph from here"].matrix_world.col[2][:3])
    bpy.ops.robir.add_box()
    answer["box"] = list(module("work.worker").box_of(settings()))
    answer["sphere"] = [*middle, 480.0, 480.0, 480.0]
    bpy.ops.robir.clear_capture()
    answer["cleared"] = bpy.data.objects["Cube"].visible_get()
    kinds = (bpy.data.collections, bpy.data.objects, bpy.data.meshes, bpy.data.materials)
    answer["left"] = [block.name for kind in kinds for block in kind if "robir_capture" in block]
    return answer


def seen_bounds():
    bpy.context.view_layer.update()
    sphere = bpy.data.objects["Bounds of the object"]
    cameras = [o for o in bpy.data.objects if "robir_view" in o]
    away = [(o.matrix_world.translation - sphere.location).length for o in cameras]
    return {
        "radius": sphere.empty_display_size,
        "centre": list(sphere.location),
        "cube": bpy.data.objects["Cube"].visible_get(),
        "distances": away,
    }


def tasks(python):
    """A task that speaks, one that is stopped, one that fails, and one that cannot be run."""
    monitor, lines, ends, spoken = module("work.monitor"), [], [], []
    speak = (
        "import json, sys; print(json.dumps({'progress': 0.5, 'message': 'half'})); "
        "print('no JSON'); print(json.dumps(['a list'])); "
        "print(json.dumps({'text': 'G\\u00e4nse'}, ensure_ascii=False)); sys.exit(7)"
    )
    wait = "import json, time; print(json.dumps({'message': 'on'}), flush=True); time.sleep(600)"

    def command(program):
        return [python, "-c", program]

    def end(*how):
        ends.append([*how, state().task])

    def hear(line):
        lines.append(line)
        spoken.append(told())

    monitor.wait_task("check_engine", command(speak), hear, end)
    silent = told()
    monitor.run_task("install", command(wait), lines.append, end)
    began = told()
    busy = []
    try:
        monitor.run_task("look", command(wait), lines.append, end)
    except Exception as fault:
        busy.append(f"{type(fault).__name__}: {fault}")
    pulse(lambda: len(lines) == 3)
    started = time.monotonic()
    monitor.cancel()
    stopping = told()
    pulse(lambda: not monitor.is_busy())
    seconds = time.monotonic() - started
    try:
        monitor.run_task("look", [python + " absent"], lines.append, end)
    except Exception as fault:
        busy.append(f"{type(fault).__name__}: {fault}")
    return {
        "lines": lines, "ends": ends, "spoken": spoken[0], "silent": silent, "began": began,
        "busy": busy, "stopping": stopping, "seconds": seconds, "last": told(),
    }  # fmt: skip
