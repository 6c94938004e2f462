# SPDX-License-Identifier: Apache-2.0
"""Progress of a run: to the result folder for pollers, and to whoever watches."""

from __future__ import annotations

import logging
import time
from collections.abc import Sequence
from typing import Any, Protocol

from robir.errors import CancelledError
from robir.jobs.paths import STAGES, JobPaths, read_json
from robir.jobs.status import Kind, State, StatusWriter

_log = logging.getLogger(__name__)

# typical share of each stage in the time of a run on two cores; only for the time left
_SHARES = {"capture": 0.01, "geometry": 0.55, "transport": 0.02, "appearance": 0.28, "export": 0.14}
_STATUS_PERIOD = 0.5
_EVENT_PERIOD = 2.0


class Display(Protocol):
    """Something that shows a run while it goes on: a terminal, a log, a pipe."""

    def event(self, event: dict[str, Any], fraction: float, seconds_left: float | None) -> None:
        """Show an event of `events.jsonl`, the run's share in [0, 1] and its seconds left."""


class RunReporter:
    """The reporter handed to every stage of one run."""

    def __init__(self, paths: JobPaths, display: Display, pending: Sequence[str]) -> None:
        """Begin to count time; stages that are not pending count as done."""
        self._warnings: list[dict[str, str]] = []
        self._metrics = _known_metrics(paths, pending)
        self._paths = paths
        self._display = display
        self._writer = StatusWriter(paths)
        self._stage = ""
        self._offset = 1.0 - sum(_SHARES[stage] for stage in pending)
        self._done = self._total = self._offset
        self._begin = time.monotonic()
        self._last_status = self._last_event = 0.0

    @property
    def stage(self) -> str:
        """Stage at work or last at work."""
        return self._stage

    def take_warnings(self) -> list[dict[str, str]]:
        """Warnings since the last call, each with its stage."""
        taken, self._warnings = self._warnings, []
        return taken

    def begin(self, stage: str) -> None:
        """A stage starts."""
        self._stage = stage
        self._announce("started", message=f"{stage} started")

    def end(self, stage: str, metrics: dict[str, Any], seconds: dict[str, float]) -> None:
        """A stage has ended well."""
        self._done = min(1.0, self._done + _SHARES[stage])
        if stage == "capture":
            # Whether poses had to be found says nothing about how long the rest takes.
            self._begin, self._offset = time.monotonic(), self._done
        self._metrics |= metrics
        self._announce("finished", message=f"{stage} done", metrics=metrics, seconds=seconds)

    def skip(self, stage: str) -> None:
        """A stage was done before."""
        self._stage = stage
        self._announce("skipped", message=f"{stage} was done before")

    def progress(self, fraction: float, message: str) -> None:
        """See `robir.jobs.context.Reporter.progress`."""
        if self._paths.cancel.exists():
            raise CancelledError("stopped on request; continue with --resume")
        total = self._total = self._done + _SHARES[self._stage] * min(max(fraction, 0.0), 1.0)
        left = self._seconds_left(total)
        now = time.monotonic()
        event: dict[str, Any] = {"kind": "progress", "stage": self._stage}
        event |= {"fraction": round(fraction, 4), "message": message}
        if now - self._last_event >= _EVENT_PERIOD:
            self._last_event = now
            self._writer.event(
                "progress", self._stage, fraction=round(fraction, 4), message=message
            )
        if now - self._last_status >= _STATUS_PERIOD:
            self._last_status = now
            self._write_status("running", total, message, seconds_left=left)
        self._display.event(event, total, left)

    def warn(self, message: str) -> None:
        """See `robir.jobs.context.Reporter.warn`."""
        self._warnings.append({"stage": self._stage, "message": message})
        _log.warning("%s: %s", self._stage, message)
        self._emit("warning", message=message)

    def metric(self, name: str, value: Any) -> None:
        """See `robir.jobs.context.Reporter.metric`."""
        self._metrics[name] = value
        self._emit("metric", name=name, value=value)

    def finish(self, message: str, exit_code: int = 0) -> None:
        """The run is over; `exit_code` is 0 unless the result failed the quality check."""
        self._done = 1.0
        self._stage = ""
        self._write_status("done", 1.0, message, exit_code=exit_code)
        _log.info(message)
        self._emit("finished", message=message)

    def pause(self, message: str) -> None:
        """The run ends early as it was asked to, and may go on; for followers it is cancelled."""
        self._write_status("cancelled", self._done, message, exit_code=0)
        _log.info(message)

    def fail(self, message: str, exit_code: int) -> None:
        """The run has ended early; a full disk does not keep the message from the watcher."""
        state = "cancelled" if exit_code == CancelledError.exit_code else "failed"
        _log.error("%s: %s", self._stage, message)
        try:
            self._write_status(state, self._done, message, exit_code=exit_code)
            self._writer.event("failed", self._stage, message=message, exit_code=exit_code)
        except OSError as error:
            _log.error("the status could not be written: %s", error.strerror)

    def _announce(self, kind: Kind, *, message: str, **facts: Any) -> None:
        _log.info(message)
        left = self._seconds_left(self._done)
        self._write_status("running", self._done, message, seconds_left=left)
        self._emit(kind, message=message, **facts)

    def _write_status(self, state: State, fraction: float, message: str, **more: Any) -> None:
        more |= {"stage": self._stage, "metrics": self._metrics}
        self._writer.status(state, fraction=fraction, message=message, **more)

    def _emit(self, kind: Kind, **facts: Any) -> None:
        event = self._writer.event(kind, self._stage, **facts)
        total = max(self._done, self._total)  # a warning comes in the middle of a stage
        self._display.event(event, total, self._seconds_left(total))

    def _seconds_left(self, total: float) -> float | None:
        worked = total - self._offset
        if worked < 0.02:
            return None
        return (time.monotonic() - self._begin) * (1.0 - total) / worked


def _known_metrics(paths: JobPaths, pending: Sequence[str]) -> dict[str, Any]:
    metrics: dict[str, Any] = {}
    for stage in STAGES:
        if stage not in pending:
            metrics |= read_json(paths.manifest(stage)).get("metrics", {})
    return metrics
