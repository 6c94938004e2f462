# SPDX-License-Identifier: Apache-2.0
"""How long the viewport stands still, and how much of the machine was ours meanwhile."""

from __future__ import annotations

import os
import time
from pathlib import Path

from window.blender_window import BlenderWindow

_TICKS = os.sysconf("SC_CLK_TCK")


class Redraws:
    """Watches the 3D viewport from its making on; `control.RedrawClock` does so inside Blender."""

    def __init__(self, window: BlenderWindow) -> None:
        self._window = window
        window.run("bpy.app.driver_namespace['redraws'].start()")
        self._start, self._own, self._all = time.monotonic(), _own_seconds(), _all_seconds()

    def longest(self) -> tuple[dict[str, float], str]:
        """End the watch.

        Returns:
            Seconds: "gap" is the longest one within one task, "share" of the processors that
            strangers left to the tests, Blender and the worker, in [0, 1], "busy" the longest that
            Blender's own thread had a processor between two drawings within one task, and "change"
            the longest gap in which a task begins or ends, as the scene is changed there. And what
            was at work in the busiest.
        """
        gaps = self._window.get("bpy.app.driver_namespace['redraws'].stop()")
        capacity = (time.monotonic() - self._start) * (os.cpu_count() or 1)
        own, all_busy = _own_seconds() - self._own, _all_seconds() - self._all
        strangers = min(max(all_busy - own, 0.0) / capacity, 0.9)
        gap, change, busiest = 0.0, 0.0, (0.0, "")
        for seconds, busy, work in gaps:
            if len({part.partition(" ")[0] for part in work.split(" -> ")}) > 1:
                change = max(change, seconds)
                continue
            gap, busiest = max(gap, seconds), max(busiest, (busy, work))
        figures = {"gap": gap, "share": 1.0 - strangers, "busy": busiest[0], "change": change}
        return figures, busiest[1]


def _all_seconds() -> float:
    """Processor time of the machine that was not idle."""
    user, nice, system, _, _, *interrupts = _numbers(Path("/proc/stat").read_text().split()[1:8])
    return (user + nice + system + sum(interrupts)) / _TICKS


def _own_seconds() -> float:
    """Processor time of all processes of this namespace, with children they have waited for."""
    total = 0.0
    for file in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = file.read_text().rpartition(")")[2].split()
        except OSError:  # it has just ended
            continue
        total += sum(_numbers(fields[11:15])) / _TICKS
    return total


def _numbers(words: list[str]) -> list[int]:
    return [int(word) for word in words]
