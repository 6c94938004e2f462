# SPDX-License-Identifier: Apache-2.0
"""What a user does to results with mouse and keys: no test here calls what it is about.

The tests are one session in their order; its file is never saved.
"""

from __future__ import annotations

import shutil
import time
from pathlib import Path

import pytest
from PIL import Image
from window.blender_window import BlenderWindow
from window.command import Finished
from window.test_what_is_kept import SEEN_FACES

pytestmark = pytest.mark.slow

STATE = "bpy.context.window_manager.robir"
SETTINGS = "bpy.context.scene.robir"
VIEW = "bpy.data.images['RobIR comparison']['robir_view']"
PIXELS = "list(bpy.data.images['RobIR comparison'].size)"
OBJECT = "bpy.context.object"
DOTS = "[o.name for o in bpy.data.objects if 'robir_spot' in o]"
LIGHT = (
    "next(n.image.filepath for n in bpy.context.scene.world.node_tree.nodes "
    "if n.type == 'TEX_ENVIRONMENT')"
)
FRAMES = (
    "[o.data.display_size for o in bpy.data.objects if o.type == 'CAMERA' and 'robir_view' in o]"
)

HEADER = """
area = next(a for a in window.screen.areas if a.type == "IMAGE_EDITOR")
region = next(r for r in area.regions if r.type == "HEADER")
answer = [region.x, window.height - region.y - region.height // 2, region.width]
"""
MIDDLE = HEADER.replace('"HEADER"', '"WINDOW"').replace("[region.x,", "[region.x + 100,")


@pytest.fixture(scope="module")
def other(finished: Finished, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same result in another folder."""
    return shutil.copytree(finished.out, tmp_path_factory.mktemp("other") / "another result")


def bring(window: BlenderWindow, folder: Path) -> None:
    """Import a result, shaded so that a processor draws it fast."""
    window.run(
        f"bpy.ops.robir.import_result(directory={str(folder)!r})\n"
        "bpy.ops.ed.undo_push(message='Import Result')\n"
        "for area in window.screen.areas:\n"
        "    if area.type == 'VIEW_3D': area.spaces.active.shading.type = 'SOLID'",
        timeout=300.0,
    )
    time.sleep(1.0)


def seen(window: BlenderWindow, thing: str = OBJECT) -> list[list[int]]:
    """Two pixels that show a thing."""
    return window.run(SEEN_FACES.format(thing=thing))[0]


def test_a_dropped_photograph_stands_for_its_folder(window: BlenderWindow, tmp_path: Path) -> None:
    for number in range(3):
        picture = Image.new("RGB", (32, 24), (10 * number, 80, 40))
        picture.save(tmp_path / f"IMG_{number}.jpg")
    place = window.view_centre()
    window.screen.drop(tmp_path / "IMG_1.jpg", place.x, place.y)
    time.sleep(1.5)
    window.picture("dropped_photograph")
    window.screen.key("t")  # of Blender's own choice between an empty and Take Capture
    window.wait_until(f"{SETTINGS}.capture")
    assert Path(window.get(f"{SETTINGS}.capture")) == tmp_path
    window.wait_until(f"not {STATE}.task")
    window.run("bpy.ops.robir.clear_capture()")


def test_what_is_shown_follows_a_click(
    window: BlenderWindow, finished: Finished, other: Path
) -> None:
    bring(window, other)
    moved = window.get(f"{OBJECT}.name")
    window.run(f"{OBJECT}.location.x = 2.0 * max({OBJECT}.dimensions)")
    bring(window, finished.out)
    window.run(
        "area = next(a for a in window.screen.areas if a.type == 'VIEW_3D')\n"
        "area.spaces.active.region_3d.view_distance *= 3"
    )
    time.sleep(1.0)
    assert Path(window.get(f"{SETTINGS}.result")) == finished.out
    window.screen.click(*seen(window, f"bpy.data.objects[{moved!r}]")[0])
    window.wait_until(f"{SETTINGS}.result == {str(other)!r}")
    place = window.find("robir.shown")
    window.screen.click(place.x, place.y)
    time.sleep(0.8)
    window.picture("results")
    window.screen.key("t")  # underlined in "the result's folder"
    window.wait_until(f"{SETTINGS}.result == {str(finished.out)!r}")
    assert window.get(f"{OBJECT}.name") != moved
    window.press_in_menu("robir.shown", "e")  # underlined in Remove Result
    window.wait_until(f"{SETTINGS}.result == {str(other)!r}")


def test_a_spot_is_clicked(window: BlenderWindow) -> None:
    places = seen(window)
    for ending, dots in (("Escape", 0), (places[0], 1)):
        window.run("bpy.ops.robir.pick_spot('INVOKE_DEFAULT')")
        time.sleep(0.5)
        assert window.get(f"{SETTINGS}.spot_result") == ""
        if isinstance(ending, str):
            window.screen.key(ending)
        else:
            window.screen.click(*ending)
        time.sleep(0.8)
        assert len(window.get(DOTS)) == dots
        assert bool(window.get(f"{SETTINGS}.spot_result")) == bool(dots)
    window.picture("spot")
    window.run("bpy.ops.robir.forget_spot()")
    assert window.get(DOTS) == []


def test_a_dropped_ground_stays_away(window: BlenderWindow) -> None:
    faces = f"len({OBJECT}.data.polygons)"
    whole = window.get(faces)
    window.run("bpy.ops.robir.stand_on_floor()\nbpy.ops.robir.drop_ground()", timeout=60.0)
    left = window.get(faces)
    assert left < whole
    window.press_in_menu("robir.shown", "r")  # underlined in Refresh Result
    window.wait_until(f"'what you did is kept' in {STATE}.message")
    assert window.get(faces) == left
    assert abs(window.get(f"min((c[2] for c in {OBJECT}.bound_box))")) < 1e-3


def test_frames_of_cameras_go_with_the_real_size(window: BlenderWindow) -> None:
    before = window.get(FRAMES)
    window.run("bpy.ops.robir.set_real_size(first=(0, 0, 0), second=(1, 0, 0), length=5)")
    assert window.get(FRAMES) == pytest.approx([5 * size for size in before])
    window.run("bpy.ops.robir.set_real_size(first=(0, 0, 0), second=(5, 0, 0), length=1)")


def test_the_export_begins_with_the_faces_there_are(window: BlenderWindow) -> None:
    faces = window.get(f"len({OBJECT}.data.polygons)")
    window.search("export glb")
    window.wait_until("len(bpy.context.window_manager.windows) == 2")
    asked = "bpy.context.window_manager.windows[1].screen.areas[0].spaces.active.active_operator"
    window.wait_until(f"{asked} is not None")
    assert window.get(f"{asked}.most_faces") == faces
    window.leave_other_windows()


def test_a_light_is_chosen_from_the_list(window: BlenderWindow) -> None:
    assert window.get(f"{SETTINGS}.light") == "recovered"
    place = window.find("robir.light")
    window.screen.click(place.x, place.y)
    time.sleep(0.8)
    window.picture("lights")
    window.screen.key("f")
    window.wait_until(f"'forest' in {LIGHT}")
    assert window.get(f"{SETTINGS}.light") == "forest"


def test_the_object_in_its_photograph(window: BlenderWindow) -> None:
    catchers = (
        "[o.name for o in bpy.context.scene.objects if o.type == 'MESH' and o.is_shadow_catcher]"
    )
    window.search("put into photograph")
    window.wait_until(f"{catchers}")
    window.picture("in_photograph")
    assert window.get("bpy.context.scene.render.film_transparent")
    assert "robir_view" in window.get("list(bpy.context.scene.camera.keys())")
    window.search("put into photograph")
    window.wait_until(f"not {catchers}")


def test_the_comparison_goes_on_by_keys_and_is_wiped(window: BlenderWindow) -> None:
    window.run(
        "area = next(a for a in window.screen.areas if a.type == 'PROPERTIES')\n"
        "area.ui_type = 'IMAGE_EDITOR'"
    )
    window.press("bpy.ops.robir.compare(")
    window.wait_until("'RobIR comparison' in bpy.data.images")
    window.screen.move(*window.run(MIDDLE)[:2])
    time.sleep(0.5)
    first, frame = window.get(VIEW), window.get("bpy.context.scene.frame_current")
    for key in ("Right", "Left"):
        window.screen.key(key)
        window.wait_until(f"({VIEW} != {first!r}) == {key == 'Right'}")
    assert window.get("bpy.context.scene.frame_current") == frame
    left, middle, _ = window.run(HEADER)
    wide = window.get(PIXELS)
    window.screen.click(left + 40, middle)  # the second of the header's buttons
    window.wait_until(f"{VIEW} != {first!r}")
    window.picture("compared")
    window.run(f"{STATE}.wipe_with = '2'")
    assert window.get(PIXELS)[0] < 0.3 * wide[0]
    window.picture("wiped")


def test_what_went_wrong_with_one_engine_is_not_said_of_another(window: BlenderWindow) -> None:
    chosen = "bpy.context.preferences.addons['bl_ext.user_default.robir'].preferences"
    window.run(
        f"{STATE}.error = {STATE}.engine_error = 'It went wrong'\n{chosen}.engine = 'MANAGED'"
    )
    assert window.get(f"{STATE}.error") == ""


def test_blender_has_nothing_to_complain_about(window: BlenderWindow) -> None:
    complaints = [line for line in window.log().splitlines() if "Traceback" in line]
    assert complaints == []
