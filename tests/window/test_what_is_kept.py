# SPDX-License-Identifier: Apache-2.0
"""What a user has chosen or made is found again: a run after a crash, an object after a refresh.

The tests are one session in their order; its file is never saved.
"""

from __future__ import annotations

import shutil
import time
from pathlib import Path

import pytest
from window.blender_window import BlenderWindow
from window.command import Finished
from window.sight import check_in_view

pytestmark = pytest.mark.slow

STATE = "bpy.context.window_manager.robir"
SETTINGS = "bpy.context.scene.robir"
OBJECT = "next(o for o in bpy.data.objects if o.type == 'MESH' and o.name != 'Cube')"

# two faces of a thing that are seen: their pixels on the screen, and their points
SEEN_FACES = """
from bpy_extras import view3d_utils
from mathutils import Vector
project = view3d_utils.location_3d_to_region_2d
area = next(a for a in window.screen.areas if a.type == "VIEW_3D")
whole = next(r for r in area.regions if r.type == "WINDOW")
view = area.spaces.active.region_3d
thing = {thing}
into, back = thing.matrix_world.inverted(), view.view_matrix.inverted()
eye, found = into @ back.translation, []
def met(x, y):
    at = Vector((x, y))
    start = into @ view3d_utils.region_2d_to_origin_3d(whole, view, at)
    end = view3d_utils.region_2d_to_vector_3d(whole, view, at)
    hit, point, _, _ = thing.ray_cast(start, into.to_3x3() @ end)
    return point if hit else Vector((1e9, 0, 0))
for face in list(thing.data.polygons)[::7]:
    hit, point, _, _ = thing.ray_cast(eye, face.center - eye)
    at = project(whole, view, thing.matrix_world @ face.center)
    # a click falls on a whole pixel: beside a face at a rim may be nothing, or what is before it
    beside = [met(at.x + x, at.y + y) for x in (-2, 2) for y in (-2, 2)]
    is_safe = max((p - face.center).length for p in beside) < 0.03 * thing.dimensions.length
    if hit and is_safe and (point - face.center).length < 1e-4:
        found.append(thing.matrix_world @ face.center)
found = [min(found, key=lambda p: p.x), max(found, key=lambda p: p.x)]
seen = [project(whole, view, point) for point in found]
answer = [
    [[round(whole.x + p.x), round(window.height - whole.y - p.y)] for p in seen],
    [list(point) for point in found],
]
"""


@pytest.fixture(scope="module")
def own(capture: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The capture where nobody has reconstructed it before."""
    return shutil.copytree(capture, tmp_path_factory.mktemp("own") / capture.name)


def drop(window: BlenderWindow, capture: Path) -> None:
    """Drop a capture on the viewport."""
    place = window.view_centre()
    window.screen.drop(capture / "transforms_train.json", place.x, place.y)


def test_a_dropped_capture_is_seen_beside_the_sidebar(window: BlenderWindow, own: Path) -> None:
    drop(window, own)
    window.wait_until(f"{STATE}.recognised and not {STATE}.task", 120.0)
    window.picture("dropped")
    assert not window.get("bpy.data.objects['Cube'].visible_get()")
    check_in_view(window, "bpy.data.objects['Bounds of the object']")


def test_a_run_is_found_again_though_nothing_was_saved(window: BlenderWindow, own: Path) -> None:
    window.press("bpy.ops.robir.reconstruct")
    window.wait_until(f"{STATE}.task == 'reconstruct' and {STATE}.stage", 120.0)
    window.kill()
    window.start()
    assert window.get(f"{SETTINGS}.capture") == ""
    drop(window, own)
    window.wait_until(f"{STATE}.task == 'reconstruct'", 120.0)
    window.picture("found_again")
    window.press("bpy.ops.robir.cancel_reconstruct")
    window.wait_until(f"not {STATE}.task")


def test_a_refresh_keeps_what_was_done(window: BlenderWindow, finished: Finished) -> None:
    window.run(f"bpy.ops.robir.import_result(directory={str(finished.out)!r})", timeout=300.0)
    assert Path(window.get(f"{SETTINGS}.result")) == finished.out
    window.run(
        "for area in window.screen.areas:\n"
        "    if area.type == 'VIEW_3D': area.spaces.active.shading.type = 'SOLID'\n"
        f"thing = {OBJECT}\n"
        "thing.location = (0.5, 0, 0)\n"
        "thing.modifiers.new('bent', 'SIMPLE_DEFORM')\n"
        "bpy.context.scene.robir.light = 'forest'"
    )
    window.press_in_menu("robir.shown", "r")  # underlined in Refresh Result
    window.wait_until(f"'newer result' in {STATE}.message")
    window.picture("refreshed")
    assert window.get(f"list({OBJECT}.location)") == [0.5, 0.0, 0.0]
    assert window.get(f"[m.name for m in {OBJECT}.modifiers]") == ["bent"]
    image = (
        "next(n for n in bpy.context.scene.world.node_tree.nodes if n.type == 'TEX_ENVIRONMENT')"
    )
    assert "forest" in window.get(f"{image}.image.name")


def test_the_real_size_is_told_by_two_clicks(window: BlenderWindow) -> None:
    window.run(f"{OBJECT}.modifiers.clear()\nbpy.context.view_layer.update()")
    window.settle()  # rays meet the shape that is drawn
    places, points = window.run(SEEN_FACES.format(thing=OBJECT))
    window.run("bpy.ops.robir.set_real_size('INVOKE_DEFAULT')")
    for place in places:
        window.screen.click(*place)
        time.sleep(0.4)
    window.picture("real_size")
    window.screen.key("Return")
    last = "bpy.context.window_manager.operators[-1]"
    window.wait_until(f"{last}.bl_idname == 'ROBIR_OT_set_real_size'")
    clicked = [window.get(f"list({last}.properties.{name})") for name in ("first", "second")]
    across = sum((a - b) ** 2 for a, b in zip(*points, strict=True)) ** 0.5
    for point, wanted in zip(clicked, points, strict=True):
        assert point == pytest.approx(wanted, abs=0.05 * across)
    assert window.get(f"{last}.properties.length") == pytest.approx(across, rel=0.1)


def test_an_edited_mesh_is_asked_about(window: BlenderWindow) -> None:
    window.run(f"{OBJECT}.data.vertices[0].co.x += 0.25")
    moved = window.get(f"{OBJECT}.data.vertices[0].co.x")
    window.press_in_menu("robir.shown", "r")  # underlined in Refresh Result
    window.picture("asked")
    window.screen.key("Escape")
    assert window.get(f"{OBJECT}.data.vertices[0].co.x") == moved


def test_a_notice_is_put_away(window: BlenderWindow) -> None:
    window.run(f"{STATE}.error, {STATE}.error_cure = 'It went wrong', 'Do this'")
    window.picture("notice")
    window.run("bpy.ops.robir.dismiss()")
    assert window.get(f"{STATE}.error") == ""
