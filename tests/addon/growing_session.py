# SPDX-License-Identifier: Apache-2.0
"""What test_growing.py has done in a Blender without a window.

Runs inside Blender after the text of capture_session.py, whose names it uses.
"""

import os
from pathlib import Path

import bpy
import numpy as np
from capture_session import module, settings, state

NAME = "RobIR growing"


def seen():
    """The growing surface as the user sees it, and how many datablocks there are of it."""
    grown = [o for o in bpy.data.objects if o.name.startswith(NAME)]
    meshes = [m for m in bpy.data.meshes if m.name.startswith(NAME)]
    answer = {"objects": len(grown), "meshes": len(meshes)}
    if grown:
        (shown,) = grown
        corners = np.empty(3 * len(shown.data.vertices), np.float32)
        shown.data.vertices.foreach_get("co", corners)
        corners = corners.reshape(-1, 3)
        bpy.context.view_layer.update()
        placed = corners @ np.array(shown.matrix_world)[:3, :3].T + shown.matrix_world.translation
        answer |= {
            "collections": [c.name for c in shown.users_collection],
            "hidden": [shown.hide_select, shown.hide_render],
            "is_selected": shown.select_get(),
            "faces": len(shown.data.polygons),
            "low": placed.min(0).tolist(),
            "high": placed.max(0).tolist(),
        }
    return answer


def facts_of(photo, centre, radius):
    """What a check says of a capture with one photograph."""
    pose = [[1, 0, 0, centre[0]], [0, 1, 0, centre[1]], [0, 0, 1, centre[2] + 3 * radius]]
    view = {
        "name": "a", "split": "train", "image": photo, "width": 48, "height": 48,
        "fx": 60.0, "fy": 60.0, "cx": 24.0, "cy": 24.0, "camera_to_world": [*pose, [0, 0, 0, 1]],
    }  # fmt: skip
    return {"accepted": True, "cameras": [view], "centre": centre, "radius": radius}


def files(photo, root, good, other, spoilt):
    """Good and spoilt files in the place of the engine's, and what takes the surface away."""
    growth = module("work.growth").Growth(Path(root))
    place, times = module("gateway").JobPaths(Path(root)).growing, iter(range(1, 1000))
    settings().out, answer = root, {}

    def put(file):
        place.write_bytes(Path(file).read_bytes())
        os.utime(place, ns=(10**18 + next(times),) * 2)
        growth.look("geometry")
        return seen()

    answer["without a capture"] = put(good)
    show = module("capture.viewport").show_capture
    list(show(bpy.context.scene, facts_of(photo, [795.0, 800.0, 0.0], 240.0)))
    answer["before"] = put(good)
    mesh = bpy.data.meshes[NAME].session_uid if bpy.app.version >= (4, 3) else 0
    answer["other"] = put(other)
    answer["is_same_mesh"] = not mesh or bpy.data.meshes[NAME].session_uid == mesh
    answer["spoilt"] = {file: put(file) for file in spoilt.split("\n")}
    place.unlink()
    growth.look("geometry")
    answer["gone"] = seen()
    answer["again"] = put(good)
    state().job = root  # undone while it grows: it is there all the same
    bpy.ops.ed.undo_push(message="with the surface")
    bpy.ops.ed.undo_push(message="something of the user's")
    bpy.ops.ed.undo()
    growth.look("geometry")
    answer["undone at work"] = seen()
    state().job = ""
    module("work.growth").clear_surface()
    bpy.ops.ed.undo_push(message="without")
    bpy.ops.ed.undo()
    answer["undone later"] = seen()
    put(good)
    saved = str(Path(root) / "saved.blend")
    bpy.ops.wm.save_as_mainfile(filepath=saved)
    bpy.ops.wm.open_mainfile(filepath=saved)
    answer["opened later"] = seen()
    put(good)
    bpy.ops.robir.clear_capture()
    answer["put away"] = seen()
    return answer
