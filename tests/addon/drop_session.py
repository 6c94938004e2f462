# SPDX-License-Identifier: Apache-2.0
"""What test_dropping.py has done in one Blender: a capture is dropped, and all goes.

Runs inside Blender.
"""

from pathlib import Path

import bpy

MODULE = "bl_ext.user_default.robir"


def main(archive, engine, capture, model, video):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    untouched = traces()
    bpy.ops.extensions.package_install_files(
        filepath=archive, repo="user_default", enable_on_install=True
    )
    preferences = bpy.context.preferences.addons[MODULE].preferences
    preferences.engine, preferences.python = "EXISTING", engine
    answer = {
        "dropped": dropped(capture),
        "colmap": drop(str(Path(model).parent), Path(model).name),
        "video": taken(video),
        "elsewhere": drop(capture, "transforms_train.json", area_type="OUTLINER"),
        "foreign": foreign(capture),
        "busy": busy(),
        "reopened": reopened(),
        "there": traces(),
    }
    for enable in (False, True, False):
        operator = bpy.ops.preferences.addon_enable if enable else bpy.ops.preferences.addon_disable
        operator(module=MODULE)
        answer["enabled" if enable else "disabled"] = traces()
    return answer | {"untouched": untouched}


def drop(directory, name, area_type="VIEW_3D"):
    """What a file that is let go over an area brings about."""
    window = bpy.context.window_manager.windows[0]
    area = window.screen.areas[0]
    before, area.type = area.type, area_type
    region = next(r for r in area.regions if r.type == "WINDOW")
    bpy.context.scene.robir.capture = ""
    try:
        with bpy.context.temp_override(window=window, area=area, region=region):
            said = list(
                bpy.ops.wm.drop_import_file(
                    "INVOKE_DEFAULT", directory=directory, files=[{"name": name}]
                )
            )
    except RuntimeError as fault:
        said = str(fault)
    area.type = before
    return [said, bpy.context.scene.robir.capture]


def taken(video):
    """A video, for which Blender has a handler too and asks which; ours is chosen."""
    place = Path(video)
    try:
        bpy.ops.robir.drop_capture(directory=str(place.parent), files=[{"name": place.name}])
        said = ""
    except RuntimeError as fault:
        said = str(fault)
    state, settings = bpy.context.window_manager.robir, bpy.context.scene.robir
    said += " ".join(finding.text for finding in state.findings)
    return said, settings.capture, state.looked_at


def dropped(capture):
    """A capture from the drop to its cameras in view, and back."""
    bpy.ops.ed.undo_push(message="Before")
    answer = {"drop": drop(capture, "transforms_test.json")}
    answer["recognised"] = bpy.context.window_manager.robir.recognised
    answer["cameras"] = cameras()
    bpy.ops.ed.undo_push(message="Drop")
    bpy.ops.ed.undo()
    answer["undone"] = [cameras(), bpy.context.scene.robir.capture]
    bpy.ops.ed.redo()
    answer["redone"] = [cameras(), bpy.context.scene.robir.capture]
    bpy.ops.robir.clear_capture()
    return answer


def cameras():
    return sum(shown.type == "CAMERA" for shown in bpy.context.scene.objects)


def foreign(capture):
    """A file that no known format has, handed to the operator itself."""
    try:
        return list(bpy.ops.robir.drop_capture(directory=capture, files=[{"name": "notes.txt"}]))
    except RuntimeError as fault:
        return str(fault)


def busy():
    """A drop while something is at work."""
    state = bpy.context.window_manager.robir
    state.task = "look"
    may = bpy.ops.robir.drop_capture.poll()
    state.task = ""
    return may


def reopened():
    """What is known of another file's capture, and of a job that was at work when it was saved."""
    state = bpy.context.window_manager.robir
    state.task, state.message = "reconstruct", "fitting the surface"
    state.findings.add().text = "clipped"
    bpy.context.scene.robir.texture = "4K"
    file = str(Path(bpy.app.tempdir) / "saved.blend")
    bpy.ops.wm.save_as_mainfile(filepath=file)
    answer = []
    for load_ui in (False, True):
        bpy.ops.wm.open_mainfile(filepath=file, load_ui=load_ui)
        state = bpy.context.window_manager.robir
        answer.append([state.task, state.message, len(state.findings)])
        state.message = "of the file before"
    return [*answer, bpy.context.scene.robir.texture]


def traces():
    """Everything by which Blender could still know the extension."""
    handlers = [
        f"{name}: {function.__module__}"
        for name in dir(bpy.app.handlers)
        if isinstance(getattr(bpy.app.handlers, name), list)
        for function in getattr(bpy.app.handlers, name)
        if getattr(function, "__module__", "").startswith(MODULE)
    ]
    menus = [
        f"{name}: {function.__name__}"
        for name in ("VIEW3D_MT_view", "TOPBAR_MT_file_import")
        for function in getattr(getattr(bpy.types, name).draw, "_draw_funcs", ())
        if function.__module__.startswith(MODULE)
    ]
    keys = bpy.context.window_manager.keyconfigs.addon
    return {
        "classes": [name for name in dir(bpy.types) if name.startswith("ROBIR_")],
        "operators": dir(bpy.ops.robir),
        "scene": hasattr(bpy.types.Scene, "robir"),
        "state": hasattr(bpy.types.WindowManager, "robir"),
        "handlers": handlers,
        "menus": menus,
        "keys": [
            item.idname
            for keymap in (keys.keymaps if keys else ())
            for item in keymap.keymap_items
            if item.idname.startswith("robir.")
        ],
    }
