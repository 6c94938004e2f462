# SPDX-License-Identifier: Apache-2.0
"""Two results in one file, chosen by clicks; keys over their comparison; a refusal said once.

The tests are one session in their order.
"""

from __future__ import annotations

import shutil
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from addon.finished import make_result
from window.blender_window import BlenderWindow, Place
from window.conftest import BUILD
from window.screen import Screen

pytestmark = pytest.mark.slow

STATE = "bpy.context.window_manager.robir"
SHOWN = "bpy.context.scene.robir.result"
COMPARED = "bpy.data.images['RobIR comparison']['robir_view']"

PLACE = """
from bpy_extras.view3d_utils import location_3d_to_region_2d as project
area = next(a for a in window.screen.areas if a.type == "VIEW_3D")
region = next(r for r in area.regions if r.type == "WINDOW")
thing = next(o for o in bpy.data.objects if o.type == "MESH" and o.get("robir_result") == {mark!r})
corners = [thing.matrix_world @ v.co for v in thing.data.vertices]
middle = sum(corners, corners[0] * 0.0) / len(corners)
at = project(region, area.spaces.active.region_3d, middle)
answer = [round(region.x + at.x), round(window.height - region.y - at.y)]
"""


@pytest.fixture(scope="module")
def window(
    screen: Screen, package: Path, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[BlenderWindow]:
    """Blender with the add-on installed."""
    window = BlenderWindow(screen, tmp_path_factory.mktemp("home"), BUILD / "pictures-results")
    window.install(package)
    window.start()
    yield window
    window.quit()


@pytest.fixture(scope="module")
def two(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Two results of a sphere."""
    first = make_result(tmp_path_factory.mktemp("made") / "first").root
    return first, shutil.copytree(first, first.with_name("second"))


def click(window: BlenderWindow, result: Path) -> None:
    """Click a result's object in the viewport."""
    place = Place(*window.run(PLACE.format(mark=str(result))))
    window.screen.click(place.x, place.y)


def test_a_click_on_an_object_shows_its_result(
    window: BlenderWindow, two: tuple[Path, Path]
) -> None:
    for result in two:
        window.run(f"bpy.ops.robir.import_result(directory={str(result)!r})", timeout=120.0)
    window.run(
        "bpy.data.objects.remove(bpy.data.objects['Cube'])\n"
        "bpy.data.objects['first'].location.x = -2.0\n"
        "bpy.data.objects['second'].location.x = 2.0\n"
        "for one in bpy.data.objects: one.hide_viewport = one.type != 'MESH'\n"
        "area = next(a for a in window.screen.areas if a.type == 'VIEW_3D')\n"
        "area.spaces.active.shading.type = 'SOLID'\n"
        "region = next(r for r in area.regions if r.type == 'WINDOW')\n"
        "with bpy.context.temp_override(window=window, area=area, region=region):\n"
        "    bpy.ops.view3d.view_all()"
    )
    time.sleep(2.0)
    for result in (*two, two[0]):
        click(window, result)
        window.wait_until(f"{SHOWN} == {str(result)!r}", 10.0)
        window.picture(f"clicked_{result.name}")


def test_the_chosen_result_is_removed_and_the_other_shown(
    window: BlenderWindow, two: tuple[Path, Path]
) -> None:
    window.press("bpy.ops.robir.remove_result")
    window.wait_until("'first' not in bpy.data.objects", 10.0)
    assert window.get("'second' in bpy.data.objects")
    assert window.get(SHOWN) == str(two[1])


def test_arrow_keys_over_the_comparison_go_from_view_to_view(window: BlenderWindow) -> None:
    # in this window: a new one gets no keyboard where there is no window manager
    area = "max((a for a in window.screen.areas if a.type == 'PROPERTIES'), key=lambda a: a.height)"
    x, y = window.run(
        f"area = {area}\narea.type = 'IMAGE_EDITOR'\n"
        "answer = [area.x + area.width // 2, window.height - area.y - area.height // 2]"
    )
    window.press("bpy.ops.robir.compare(")
    window.wait_until("'RobIR comparison' in bpy.data.images", 20.0)
    first, frame = window.get(COMPARED), window.get("bpy.context.scene.frame_current")
    window.screen.move(x, y)
    time.sleep(1.0)
    window.screen.key("Right")
    window.wait_until(f"{COMPARED} != {first!r}", 10.0)
    window.picture("next_view")
    window.screen.key("Left")
    window.wait_until(f"{COMPARED} == {first!r}", 10.0)
    assert window.get("bpy.context.scene.frame_current") == frame
    place = window.view_centre()
    window.screen.move(place.x, place.y)
    time.sleep(1.0)
    window.screen.key("Right")
    window.wait_until(f"bpy.context.scene.frame_current == {frame + 1}", 10.0)
    assert window.get(COMPARED) == first


def test_a_refusal_takes_no_click(window: BlenderWindow, two: tuple[Path, Path]) -> None:
    (two[1] / "report" / "index.html").unlink()
    window.press("bpy.ops.robir.open_report")
    window.wait_until(f"'is missing' in {STATE}.error", 10.0)
    window.picture("refused")
    window.press("bpy.ops.robir.dismiss")  # the very next click is heard
    window.wait_until(f"not {STATE}.error", 10.0)
