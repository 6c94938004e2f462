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


def test_a_capture_is_chosen_and_looked_at(window: BlenderWindow) -> None:
    window.search("try the sample")
    window.wait_until(f"{SETTINGS}.result")
    window.run(
        "for area in window.screen.areas:\n"
        "    if area.type == 'VIEW_3D': area.spaces.active.shading.type = 'SOLID'"
    )
    window.search("reconstruct it yourself")
    window.wait_until(f"{STATE}.recognised and not {STATE}.task", 120.0)
    assert Path(window.get(f"{SETTINGS}.capture")).name == "avocado"


def test_texture_and_device_are_chosen(window: BlenderWindow) -> None:
    window.search("texture 4k")
    window.search("device processor")
    assert window.get(f"[{SETTINGS}.texture, {SETTINGS}.device]") == ["4K", "cpu"]


def test_a_reconstruction_is_started_and_stopped(window: BlenderWindow) -> None:
    window.search("robir reconstruct")
    window.wait_until(f"{STATE}.task == 'reconstruct'")
    window.screen.key("Escape")
    time.sleep(1.0)
    window.screen.key("Return")
    window.wait_until(f"not {STATE}.task")


def test_the_capture_is_let_go(window: BlenderWindow) -> None:
    window.search("clear capture")
    window.wait_until(f"not {SETTINGS}.capture")
