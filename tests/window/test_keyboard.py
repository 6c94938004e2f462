# SPDX-License-Identifier: Apache-2.0
"""The click path without a click: what Blender's search finds, and nothing but keys."""

from __future__ import annotations

import time
from pathlib import Path

import pytest
from window.blender_window import BlenderWindow

pytestmark = pytest.mark.slow

STATE = "bpy.context.window_manager.robir"
SETTINGS = "bpy.context.scene.robir"


@pytest.fixture(scope="module", autouse=True)
def _rests_on_the_view(window: BlenderWindow) -> None:
    """A search belongs to the editor that the mouse rests on."""
    place = window.view_centre()
    window.screen.move(place.x, place.y)
    time.sleep(0.4)


# what F3 does; a virtual keyboard has no such key
OPEN = """
area = next(a for a in window.screen.areas if a.type == "VIEW_3D")
region = next(r for r in area.regions if r.type == "WINDOW")
with bpy.context.temp_override(window=window, area=area, region=region):
    bpy.ops.wm.search_menu("INVOKE_DEFAULT")
"""


def search(window: BlenderWindow, words: str) -> None:
    """Do what the search finds first; letters that come before its field is open are lost."""
    window.run(OPEN)
    time.sleep(2.5)
    window.screen.write(words)
    time.sleep(2.5)
    window.picture(f"searched_{words.replace(' ', '_')}")
    window.screen.key("Return")
    time.sleep(1.5)


def test_a_capture_is_chosen_and_looked_at(window: BlenderWindow) -> None:
    search(window, "try the sample")
    window.wait_until(f"{SETTINGS}.result")
    window.run(
        "for area in window.screen.areas:\n"
        "    if area.type == 'VIEW_3D': area.spaces.active.shading.type = 'SOLID'"
    )
    search(window, "reconstruct it yourself")
    window.wait_until(f"{STATE}.recognised and not {STATE}.task", 120.0)
    assert Path(window.get(f"{SETTINGS}.capture")).name == "avocado"


def test_preset_and_device_are_chosen(window: BlenderWindow) -> None:
    search(window, "preset standard")
    search(window, "device processor")
    assert window.get(f"[{SETTINGS}.preset, {SETTINGS}.device]") == ["standard", "cpu"]


def test_a_reconstruction_is_started_and_stopped(window: BlenderWindow) -> None:
    search(window, "robir reconstruct")
    window.wait_until(f"{STATE}.task == 'reconstruct'")
    window.screen.key("Escape")
    time.sleep(1.0)
    window.screen.key("Return")
    window.wait_until(f"not {STATE}.task")


def test_the_capture_is_let_go(window: BlenderWindow) -> None:
    search(window, "clear capture")
    window.wait_until(f"not {SETTINGS}.capture")
