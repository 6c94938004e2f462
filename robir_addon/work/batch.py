# SPDX-License-Identifier: GPL-3.0-or-later
"""Where the batch of the shown library stands: read by a timer, for drawing itself reads nothing.

A batch is a process of its own that `robir batch` leads; all that is known of it is its state file.
"""

from dataclasses import dataclass
from typing import Any

import bpy

from ..gateway import holder, library
from ..words import duration, words
from . import monitor
from .worker import absolute

MOST = 12  # captures that are listed; those that need a look come first
_PERIOD = 1.0
_ORDER = ("failed", "running", "waiting", "dropped", "done")
_STARTING = 20  # looks that a batch has to come to its lock


@dataclass(frozen=True)
class Queue:
    """A batch as it is shown: share that is over, and name, state and message of captures."""

    is_live: bool = False
    fraction: float = 0.0
    text: str = ""
    captures: tuple[tuple[str, str, str], ...] = ()


_shown = [Queue()]
_patience = [0]


def shown() -> Queue:
    """What was read last; touches no file."""
    return _shown[0]


def library_paths(settings: bpy.types.PropertyGroup) -> library.LibraryPaths | None:
    """The chosen library; None where none is chosen."""
    root = absolute(settings.library)
    return None if root is None else library.LibraryPaths(root)


def chosen(settings: bpy.types.PropertyGroup) -> library.LibraryPaths:
    """The same where operators have made sure that one is."""
    paths = library_paths(settings)
    assert paths is not None
    return paths


def follow() -> None:
    """Look now, and go on looking for as long as a batch is at work."""
    _patience[0] = _STARTING
    look()


def look() -> None:
    """Read where the batch stands."""
    _shown[0] = _read()
    if shown().is_live and not bpy.app.background and not bpy.app.timers.is_registered(_again):
        bpy.app.timers.register(_again, first_interval=_PERIOD, persistent=True)


def _again() -> float | None:
    _shown[0] = _read()
    monitor.redraw()
    return _PERIOD if shown().is_live else None


def _read() -> Queue:
    paths = library_paths(bpy.context.scene.robir)
    if paths is None:
        return Queue()
    is_held = holder(paths.lock) is not None
    _patience[0] = 0 if is_held else max(0, _patience[0] - 1)
    is_live = is_held or _patience[0] > 0
    try:
        state = library.read_batch(paths)
    except (OSError, ValueError):  # none yet, or a damaged one: the next look tells
        return Queue(is_live=is_live, text=words("starting") if is_live else "")
    rows = [_row(row, is_live) for row in state["captures"]]
    first = library.preferred(paths)
    place = {name: number for number, name in enumerate(first)}
    rows.sort(
        key=lambda row: (
            _ORDER.index(row[1]) if row[1] in _ORDER else len(_ORDER),
            place.get(row[0], len(first)),
        )
    )
    done = sum(row[1] == "done" for row in rows)
    text = words("{done} of {count} done", done=done, count=len(rows))
    if is_live and state["seconds_left"] is not None:
        text = words(
            "{share}, {duration} left", share=text, duration=duration(state["seconds_left"])
        )
    return Queue(is_live, min(max(state["fraction"], 0.0), 1.0), text, tuple(rows))


def _row(row: dict[str, Any], is_live: bool) -> tuple[str, str, str]:
    """Name, state and message of a capture: nothing runs in a batch that is paused."""
    if row["state"] == "dropped":
        return row["name"], "dropped", words("left out")
    if row["state"] == "running" and not is_live:
        return row["name"], "waiting", words("paused")
    return row["name"], row["state"], row["message"]


HANDLERS = (("load_post", lambda *_: look()),)


def unregister() -> None:
    """Look no more."""
    if bpy.app.timers.is_registered(_again):
        bpy.app.timers.unregister(_again)
    _shown[0] = Queue()
