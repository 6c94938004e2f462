# SPDX-License-Identifier: Apache-2.0
"""Where a run stands: `status.json` for pollers, `events.jsonl` for the whole story."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any, Literal, get_args

from robir.jobs.paths import JobPaths, write_json
from robir.jobs.records import DamagedFileError, read_record

State = Literal["running", "done", "failed", "cancelled"]
_FORM = {
    "state": str, "stage": str, "fraction": float, "message": str, "seconds_left": (None, float),
    "exit_code": (None, int), "pid": int, "heartbeat": float, "metrics?": {},
}  # fmt: skip
Kind = Literal["started", "skipped", "progress", "metric", "warning", "finished", "failed"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Status:
    """Latest state of a run."""

    state: State  # "running" also when the process died; see `heartbeat` and `pid`
    stage: str  # stage at work or last at work; empty before the first
    fraction: float  # share of the whole run that is done, in [0, 1]
    message: str  # what is being done, or the sentence that says why the run ended
    seconds_left: float | None  # estimated wall seconds to the end; None while nothing is known
    exit_code: int | None  # what the process exits with; None while it runs
    pid: int  # process that writes this
    heartbeat: float  # Unix time of this writing, seconds
    metrics: Mapping[str, Any] = field(default_factory=dict)  # latest values by name


def read_status(path: Path) -> Status:
    """Read what `StatusWriter` of any version wrote; OSError without, ValueError if damaged."""
    plain = read_record(path, _FORM)
    if plain["state"] not in get_args(State):
        raise DamagedFileError(f"{path.name} states {plain['state'][:40]!r}")
    known = {item.name for item in fields(Status)}
    return Status(**{name: value for name, value in plain.items() if name in known})


class StatusWriter:
    """The one writer of a run's status and events."""

    def __init__(self, paths: JobPaths) -> None:
        """Write into the result folder, which exists."""
        self._paths = paths

    def status(
        self,
        state: State,
        *,
        stage: str,
        fraction: float,
        message: str,
        seconds_left: float | None = None,
        exit_code: int | None = None,
        metrics: Mapping[str, Any] | None = None,
    ) -> None:
        """Replace `status.json`; arguments as the attributes of `Status`."""
        status = Status(
            state=state,
            stage=stage,
            fraction=round(fraction, 4),
            message=message,
            seconds_left=None if seconds_left is None else round(seconds_left, 1),
            exit_code=exit_code,
            pid=os.getpid(),
            heartbeat=time.time(),
            metrics=dict(metrics or {}),
        )
        write_json(self._paths.status, asdict(status))

    def event(self, kind: Kind, stage: str, **facts: Any) -> dict[str, Any]:
        """Append one line to `events.jsonl`; the stage is "" for the run as a whole."""
        event = {"time": round(time.time(), 3), "kind": kind, "stage": stage, **facts}
        line = json.dumps(event, ensure_ascii=False) + "\n"
        with self._paths.events.open("a", encoding="utf-8") as file:
            file.write(line)
        return event
