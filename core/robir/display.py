# SPDX-License-Identifier: Apache-2.0
"""Shows a run on standard error: a live bar, plain lines, or JSON lines."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Literal

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from robir.pipeline.reporter import Display

ProgressStyle = Literal["auto", "rich", "plain", "json"]

_PLAIN_PERIOD = 10.0


@contextmanager
def display_for(style: ProgressStyle) -> Iterator[Display]:
    """The display of a style; "auto" is a live bar on a terminal and plain lines elsewhere."""
    if style == "json":
        yield JsonDisplay()
    elif style == "plain" or (style == "auto" and not sys.stderr.isatty()):
        yield PlainDisplay()
    else:
        with RichDisplay() as display:
            yield display


def readable_seconds(seconds: float | None) -> str:
    """Such as "1:05 left"; empty where nothing is known."""
    return "" if seconds is None else f"{int(seconds) // 60}:{int(seconds) % 60:02d} left"


class JsonDisplay:
    """One JSON object a line, as in `events.jsonl` with the overall fraction and seconds left."""

    def event(self, event: dict[str, Any], fraction: float, seconds_left: float | None) -> None:
        """See `Display.event`."""
        whole = event | {"total": round(fraction, 4), "seconds_left": seconds_left}
        sys.stderr.write(json.dumps(whole, ensure_ascii=False) + "\n")
        sys.stderr.flush()


class PlainDisplay:
    """A line when something happens, and one every ten seconds in between."""

    def __init__(self) -> None:
        """Begin to count time."""
        self._last = time.monotonic()

    def event(self, event: dict[str, Any], fraction: float, seconds_left: float | None) -> None:
        """See `Display.event`."""
        kind = event["kind"]
        now = time.monotonic()
        if kind == "metric" or (kind == "progress" and now - self._last < _PLAIN_PERIOD):
            return
        self._last = now
        text = _sentence(event)
        sys.stderr.write(
            f"[{fraction:4.0%}] {text} {readable_seconds(seconds_left)}".rstrip() + "\n"
        )
        sys.stderr.flush()


class RichDisplay:
    """A live bar with the time left; warnings and finished stages stay above it."""

    def __init__(self) -> None:
        """Make the bar; it appears on entry."""
        self._bar = Progress(
            TextColumn("{task.fields[stage]:<10}"),
            BarColumn(),
            TextColumn("{task.percentage:>3.0f}%"),
            TimeElapsedColumn(),
            TextColumn("{task.fields[left]}"),
            TextColumn("{task.description}"),
            console=Console(stderr=True),
        )
        self._task = self._bar.add_task("", total=1.0, stage="", left="")

    def __enter__(self) -> RichDisplay:
        """Show the bar."""
        self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        """Leave the bar as it stands."""
        self._bar.stop()

    def event(self, event: dict[str, Any], fraction: float, seconds_left: float | None) -> None:
        """See `Display.event`."""
        if event["kind"] in ("warning", "finished", "skipped"):
            self._bar.console.print(_sentence(event), highlight=False, markup=False)
        if event["kind"] != "metric":
            self._bar.update(
                self._task,
                completed=fraction,
                stage=event["stage"],
                left=readable_seconds(seconds_left),
                description=event["message"] if event["kind"] == "progress" else "",
            )


def _sentence(event: dict[str, Any]) -> str:
    if event["kind"] == "warning":
        return f"warning: {event['message']}"
    if event["kind"] == "progress":
        return f"{event['stage']}: {event['message']}"
    if event["kind"] == "finished" and "seconds" in event:
        seconds = event["seconds"]
        return f"{event['message']} ({seconds['wall']:.1f} s, {seconds['cpu']:.1f} CPU-s)"
    return str(event["message"])
