# SPDX-License-Identifier: Apache-2.0
"""Where each capture of a library stands, told by its result folder alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from robir.batch.plan import Entry, Plan
from robir.errors import RobirError
from robir.export.asset import is_current, possible
from robir.jobs.client import Snapshot
from robir.jobs.library import LibraryPaths
from robir.jobs.paths import STAGES, write_json
from robir.pipeline.folder import read_config, read_run

State = Literal["waiting", "running", "done", "failed", "dropped"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Standing:
    """Where one capture stands."""

    name: str  # of its result folder
    state: State  # "done" also where the result failed its own quality check
    fraction: float = 0.0  # share that is done, in [0, 1]
    message: str = ""  # what is being done, or why it ended
    exit_code: int | None = None  # None while it runs, or where it was killed


def is_done(plan: Plan, entry: Entry, paths: LibraryPaths) -> bool:
    """Whether the result is whole and what the plan asks for, of the present photographs."""
    request, job = plan.request(entry, paths), paths.result(entry.name)
    config = entry.config()
    try:
        run = read_run(job)
        if run is None or run["state"] != "done" or read_config(job) != config:
            return False
        from robir.pipeline.inputs import capture_fingerprint  # a second to load

        follows_links = config.capture.outside == "take"
        capture = capture_fingerprint(request.capture, request.masks, request.out, follows_links)
    except RobirError:
        return False
    return (
        run["capture"]["fingerprint"] == capture
        and all(job.manifest(stage).is_file() for stage in STAGES)
        and is_current(job, possible(plan.facts(entry)))
    )


def of_snapshot(name: str, snapshot: Snapshot) -> Standing:
    """Where a capture stands by what its result folder says."""
    if snapshot.state == "none":
        return Standing(name=name, state="waiting")
    if snapshot.is_live:
        stage = f"{snapshot.stage}: " if snapshot.stage else ""
        message = f"{stage}{snapshot.message}"
        return Standing(name=name, state="running", fraction=snapshot.fraction, message=message)
    if snapshot.state == "cancelled" and snapshot.exit_code == 0:  # at the end of its own stages
        left = {"fraction": snapshot.fraction, "message": snapshot.message}
        return Standing(name=name, state="waiting", **left)
    is_whole = snapshot.state == "done"
    return Standing(
        name=name,
        state="done" if is_whole else "failed",
        fraction=1.0 if is_whole else snapshot.fraction,
        message=snapshot.message,
        exit_code=snapshot.exit_code,
    )


def write_standings(
    paths: LibraryPaths, standings: Sequence[Standing], seconds_left: float | None
) -> None:
    """Write the state of the whole batch for who follows it."""
    rows = [
        {"name": s.name, "state": s.state, "fraction": round(s.fraction, 4), "message": s.message}
        for s in standings
    ]
    left = None if seconds_left is None else round(seconds_left)
    whole = {"fraction": round(fraction_of(standings), 4), "seconds_left": left, "captures": rows}
    write_json(paths.state, whole)


def fraction_of(standings: Sequence[Standing]) -> float:
    """Share of the whole batch that is over, in [0, 1]."""
    over = ("done", "failed", "dropped")
    return sum(1.0 if s.state in over else s.fraction for s in standings) / len(standings)
