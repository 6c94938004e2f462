# SPDX-License-Identifier: GPL-3.0-or-later
"""Runs inside Blender: code dropped into a folder is executed between two events.

Blender reads this file with `--python`; the folder is in the environment variable
ROBIR_WINDOW_CONTROL. A request is `request.py`; its answer is `answer.json` with either `answer`
(what the code assigned to that name) or `fault` (a traceback).
"""

import json
import os
import sys
import time
import traceback
from itertools import pairwise
from pathlib import Path

import bpy

FOLDER = Path(os.environ["ROBIR_WINDOW_CONTROL"])
PERIOD = 0.02
REDRAW_PERIOD = 0.4


def _serve() -> float:
    request = FOLDER / "request.py"
    if request.exists():
        source = request.read_text(encoding="utf-8")
        request.unlink()
        temporary = FOLDER / "answer.part"
        temporary.write_text(json.dumps(_run(source)), encoding="utf-8")
        temporary.replace(FOLDER / "answer.json")
    return PERIOD


def _run(source: str) -> dict[str, object]:
    window = bpy.context.window_manager.windows[0]
    names: dict[str, object] = {"bpy": bpy, "sys": sys, "window": window, "answer": None}
    try:
        with bpy.context.temp_override(window=window):
            exec(compile(source, "request", "exec"), names)
        json.dumps(names["answer"])
    except Exception:
        return {"fault": traceback.format_exc()}
    return {"answer": names["answer"]}


class RedrawClock:
    """When the 3D viewport was drawn, while something asks for a drawing every REDRAW_PERIOD."""

    def __init__(self) -> None:
        self._drawn: list[tuple[float, float, str]] = []
        self._handler = None

    def start(self) -> None:
        """Forget the past and record from now on."""
        self._drawn = []
        self._record()
        if self._handler is None:
            self._handler = bpy.types.SpaceView3D.draw_handler_add(
                self._record, (), "WINDOW", "POST_PIXEL"
            )
            bpy.app.timers.register(self._ask, first_interval=REDRAW_PERIOD)

    def stop(self) -> list[tuple[float, float, str]]:
        """Stop recording; returns of every gap between drawings its seconds, those in which
        Blender's own thread had a processor, and what was at work meanwhile.
        """
        if self._handler is not None:
            bpy.types.SpaceView3D.draw_handler_remove(self._handler, "WINDOW")
            self._handler = None
        self._record()
        return [
            (end - start, ran - run, before if before == after else f"{before} -> {after}")
            for (start, run, before), (end, ran, after) in pairwise(self._drawn)
        ]

    def _record(self) -> None:
        state = bpy.context.window_manager.robir
        work = f"{state.task} {state.stage}".strip()
        self._drawn.append((time.perf_counter(), time.thread_time(), work))

    def _ask(self) -> float | None:
        if self._handler is None:
            return None
        for window in bpy.context.window_manager.windows:
            for area in window.screen.areas:
                if area.type == "VIEW_3D":
                    area.tag_redraw()
        return REDRAW_PERIOD


bpy.context.preferences.view.show_splash = False
# Smooth lines are eight times the work for a processor that draws; measured gaps would show it.
bpy.context.preferences.system.viewport_aa = "OFF"
for scene in bpy.data.scenes:
    scene.eevee.taa_samples = 1
bpy.app.driver_namespace["redraws"] = RedrawClock()
bpy.app.timers.register(_serve, first_interval=0.5, persistent=True)
