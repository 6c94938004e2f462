# SPDX-License-Identifier: Apache-2.0
"""The command `robir batch`: which captures are missing, and who does them."""

from __future__ import annotations

import sys
import time
from argparse import Namespace
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

from robir.batch.farm import FIT, library_job, submit_to_slurm, write_openjd
from robir.batch.local import (
    Item,
    Limits,
    LocalBatch,
    Standing,
    fraction_of,
    is_done,
    memory_needed,
    of_snapshot,
    write_standings,
)
from robir.batch.page import SheetRow, row_of, write_facts, write_page
from robir.batch.plan import Plan, keep_plan, kept_plan, parse_size, read_plan
from robir.display import display_for
from robir.errors import CaptureError, QualityError, StorageError, UsageError
from robir.jobs import client
from robir.jobs.folder import folder_lock, refuse_special
from robir.jobs.library import LibraryPaths
from robir.jobs.paths import STAGES
from robir.pipeline.device import machine
from robir.pipeline.faults import stop_requested
from robir.pipeline.reporter import Display
from robir.workers import available_cores

_STATE_PERIOD = 2.0
_PAGE_PERIOD = 20.0  # seconds between two writings of the state and of the page
_SPARE = 0.9  # share of the free memory that is used where none is given
# exit codes that a farm need not try again: the page tells of them
_OF_THE_CAPTURE = frozenset(kind.exit_code for kind in (UsageError, CaptureError, QualityError))


def batch(options: Namespace, program: Sequence[str] | None = None) -> int:
    """Do what is missing of a library, or hand it to a farm; the largest failing exit code or 0."""
    paths = LibraryPaths(options.out)
    program = program or (sys.executable, "-P", "-m", "robir")
    refuse_special(paths.root, paths.taken)
    if options.task is not None:
        plan = kept_plan(paths, options.captures)
        refuse_special(paths.root, {entry.name for entry in plan.entries})
        if not 0 <= options.task < len(plan.entries):
            raise UsageError(f"{paths.plan} has {len(plan.entries)} captures, counted from 0")
        return _do_one(plan, options, paths, program)
    if options.split and options.on == "local":
        raise UsageError("--split is for farms; give it with --on slurm or --on openjd")
    if options.fit_queue and not (options.split and options.on == "slurm"):
        raise UsageError("--fit-queue is a partition of Slurm's; give it with --on slurm --split")
    _make(paths.root)
    with folder_lock(paths.lock):
        plan = _plan(options, paths)
        refuse_special(paths.root, {entry.name for entry in plan.entries})
        write_facts(plan, paths)
        if options.page:
            return _draw(plan, paths)
        items = _items(plan, paths)
        if options.on == "local":
            return _do_all(plan, items, options, paths, program)
        return _hand_over(plan, items, options, paths)


def _make(root: Path) -> None:
    try:
        root.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StorageError(
            f"the library {root} cannot be made: {error.strerror}; give another with -o"
        ) from error


def _plan(options: Namespace, paths: LibraryPaths) -> Plan:
    if options.sources:
        plan = read_plan(options.sources, {"settings": options.assignments}, paths)
    elif options.resume or options.page:
        plan = kept_plan(paths, options.captures)
    else:
        raise UsageError("name a plan or captures, or go on with --resume")
    if options.format:
        plan = replace(plan, options=replace(plan.options, formats=options.format))
    if options.sources or options.format:
        keep_plan(plan, paths)
    for entry in plan.entries if options.sources else ():
        (paths.dropped / entry.name).unlink(missing_ok=True)
    return plan


def _items(plan: Plan, paths: LibraryPaths, *only: int) -> list[Item]:
    """All captures, those that are done marked so."""
    items = []
    for number in only or range(len(plan.entries)):
        entry = plan.entries[number]
        need, standing = 0, Standing(name=entry.name, state="waiting")
        if is_done(plan, entry, paths):
            code = client.snapshot(paths.result(entry.name).root.absolute()).exit_code
            standing = replace(standing, state="done", fraction=1.0, exit_code=code)
        else:
            need = memory_needed(plan, entry)
        items.append(Item(request=plan.request(entry, paths), need=need, standing=standing))
    return items


def _limits(options: Namespace, plan: Plan) -> Limits:
    jobs = options.jobs
    if jobs is None:
        is_shared = plan.options.device != "cpu" and Path("/dev/nvidia0").exists()
        jobs = 1 if is_shared else available_cores()
    free = machine("cpu").free_memory_bytes
    memory = parse_size(options.memory) if options.memory else int(_SPARE * free)
    return Limits(jobs=jobs, memory=memory or 1 << 62)


def _do_one(plan: Plan, options: Namespace, paths: LibraryPaths, program: Sequence[str]) -> int:
    """One capture as a task of a farm: its own faults are on the page, the machine's are told."""
    items = _items(plan, paths, options.task)
    first, last = options.stages
    job, before = paths.result(items[0].standing.name), STAGES[: STAGES.index(first)]
    if missing := [stage for stage in before if not job.manifest(stage).is_file()]:
        sys.stderr.write(f"{items[0].standing.name}: {missing[0]} is not done; its task says why\n")
        return 0
    if options.stages != (STAGES[0], STAGES[-1]):
        device = items[0].request.device if first == FIT else "cpu"
        items[0].request = replace(items[0].request, until=last, device=device)
    run = LocalBatch(paths, items, Limits(jobs=1, memory=1 << 62), program)
    with stop_requested(), display_for(options.progress) as display:
        run.run(_Watcher(items, display))
    standing = items[0].standing
    code = _code(items)
    if standing.state == "failed":
        sys.stderr.write(f"robir: {standing.name}: {standing.message}\n")
    return 0 if code in _OF_THE_CAPTURE else code


def _do_all(
    plan: Plan, items: list[Item], options: Namespace, paths: LibraryPaths, program: Sequence[str]
) -> int:
    run = LocalBatch(paths, items, _limits(options, plan), program)
    book = _Book(plan, items, paths)
    with display_for(options.progress) as display:
        watch = _Watcher(items, display, book)
        try:
            with stop_requested():
                run.run(watch)
        finally:
            book.write(None)
    for item in items:
        if item.standing.state == "failed":
            sys.stderr.write(f"robir: {item.standing.name}: {item.standing.message}\n")
    sys.stdout.write(f"{paths.page.resolve()}\n")
    return _code(items)


def _draw(plan: Plan, paths: LibraryPaths) -> int:
    rows = []
    for entry in plan.entries:
        snapshot = client.snapshot(paths.result(entry.name).root.absolute())
        rows.append(row_of(entry, of_snapshot(entry.name, snapshot), paths, plan.options.formats))
    write_page(rows, paths)
    sys.stdout.write(f"{paths.page.resolve()}\n")
    return 0


def _hand_over(plan: Plan, items: list[Item], options: Namespace, paths: LibraryPaths) -> int:
    tasks = [number for number, item in enumerate(items) if item.standing.state != "done"]
    if not tasks:
        sys.stderr.write("nothing is missing\n")
        return _draw(plan, paths)
    memory = max(item.need for item in items)
    queue = options.fit_queue or "" if options.split else None
    job = library_job(paths, plan.captures, tasks, memory, queue)
    if options.on == "openjd":
        sys.stdout.write(f"{write_openjd(job, paths.openjd).resolve()}\n")
        return 0
    queued = submit_to_slurm(job, paths.own)
    shown = ",".join(queued)
    sys.stderr.write(f"{len(tasks)} captures are queued; see them with: squeue --job {shown}\n")
    sys.stdout.write("".join(f"{number}\n" for number in queued))
    return 0


def _code(items: Sequence[Item]) -> int:
    """The largest exit code; 1 where a process was killed."""
    codes = [item.standing.exit_code for item in items if item.standing.state == "done"]
    failed = [item.standing.exit_code for item in items if item.standing.state == "failed"]
    return max([0, *(code or 0 for code in codes), *(max(1, code or 1) for code in failed)])


class _Book:
    """Writes state and page of the whole library."""

    def __init__(self, plan: Plan, items: Sequence[Item], paths: LibraryPaths) -> None:
        self._plan, self._items, self._paths = plan, items, paths
        self._rows: dict[str, tuple[Standing, SheetRow]] = {}
        self._state_at = self._page_at = 0.0

    def note(self, seconds_left: float | None) -> None:
        """Write what is due."""
        now = time.monotonic()
        if now - self._page_at > _PAGE_PERIOD:
            self.write(seconds_left)
            self._page_at = self._state_at = time.monotonic()
        elif now - self._state_at > _STATE_PERIOD:
            self._write_state(seconds_left)
            self._state_at = time.monotonic()

    def write(self, seconds_left: float | None) -> None:
        """Write both now; a full disk ends no batch, as it may be but one capture's."""
        for entry, item in zip(self._plan.entries, self._items, strict=True):
            known = self._rows.get(entry.name)
            if known is None or known[0] != item.standing:
                row = row_of(entry, item.standing, self._paths, self._plan.options.formats)
                self._rows[entry.name] = (item.standing, row)
        self._write_state(seconds_left)
        with suppress(OSError):
            write_page([row for _, row in self._rows.values()], self._paths)

    def _write_state(self, seconds_left: float | None) -> None:
        with suppress(OSError):
            write_standings(self._paths, [item.standing for item in self._items], seconds_left)


class _Watcher:
    """Shows a batch as one run: how much is done, and what is at work."""

    def __init__(self, items: Sequence[Item], display: Display, book: _Book | None = None) -> None:
        self._items, self._display, self._book = items, display, book
        self._begin = time.monotonic()
        self._offset = fraction_of([item.standing for item in items])
        self._told: dict[str, str] = {}

    def __call__(self) -> None:
        """Look at all items once."""
        standings = [item.standing for item in self._items]
        fraction = fraction_of(standings)
        worked = fraction - self._offset
        spent = time.monotonic() - self._begin
        left = spent * (1.0 - fraction) / worked if worked > 0.02 / len(standings) else None
        if self._book is not None:
            self._book.note(left)
        for standing in standings:
            self._tell(standing, fraction, left)
        self._show({"kind": "progress", "message": _summary(standings)}, fraction, left)

    def _tell(self, standing: Standing, fraction: float, left: float | None) -> None:
        """Say once how a capture ended."""
        before = self._told.get(standing.name)
        self._told[standing.name] = standing.state
        if before not in (None, standing.state) and standing.state not in ("running", "waiting"):
            kind = "warning" if standing.state == "failed" else "finished"
            said = f": {standing.message}" if standing.state == "failed" else ""
            message = f"{standing.name} {standing.state}{said}"
            self._show({"kind": kind, "message": message}, fraction, left)

    def _show(self, event: dict[str, Any], fraction: float, left: float | None) -> None:
        self._display.event({"stage": "batch", **event}, fraction, left)


def _summary(standings: Sequence[Standing]) -> str:
    count = {state: sum(s.state == state for s in standings) for state in ("done", "failed")}
    working = [s for s in standings if s.state == "running"]
    now = "; ".join(f"{s.name} {s.fraction:.0%}" for s in working[:3])
    more = f" and {len(working) - 3} more" if len(working) > 3 else ""
    failed = f", {count['failed']} failed" if count["failed"] else ""
    return f"{count['done']} of {len(standings)} done{failed}; {now}{more}"
