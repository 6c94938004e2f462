# SPDX-License-Identifier: Apache-2.0
"""Runs the captures of a library on this machine, one process each.

A process leads a life of its own: it goes on when the batch is killed, and the next one finds it by
the lock in its result folder. What a batch knows it reads from result folders, so it has nothing to
lose. How much memory a capture will need is estimated from its photographs and settings: what torch
and the libraries take, and the largest of cells of the finest distance field, texels and rays, and
pixels; the factors are rounded up from measured peaks, see docs/batch.md.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Literal

from robir.batch.plan import Entry, Plan, parse_size
from robir.errors import (
    CancelledError,
    CaptureError,
    DeviceError,
    QualityError,
    RobirError,
    UsageError,
)
from robir.export.asset import is_current, possible
from robir.jobs import client
from robir.jobs.client import Snapshot
from robir.jobs.library import LibraryPaths, preferred
from robir.jobs.paths import STAGES, write_json
from robir.pipeline.faults import stop_held
from robir.pipeline.folder import read_config, read_run
from robir.workers import CORES, available_cores

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
        from robir.pipeline.ledger import capture_fingerprint  # a second to load

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


_PERIOD = 0.5  # seconds between two looks at the result folders of what is at work
_PATIENCE = 15.0  # seconds that a process has to end in good order
_TRIES = 2
_KILLED = -9

# exit codes that a second try would only repeat: the user's to mend, or wanted by the user
_FINAL = frozenset(
    kind.exit_code for kind in (UsageError, CaptureError, QualityError, CancelledError)
)
_HUNGRY = frozenset({_KILLED, DeviceError.exit_code})  # had too little memory


@dataclass(frozen=True, slots=True, kw_only=True)
class Limits:
    """What the machine may be asked for."""

    jobs: int  # most captures at a time
    memory: int  # bytes of main memory that all of them together may need
    cores: int = field(default_factory=available_cores)  # that those at a time share


@dataclass(slots=True, kw_only=True)
class Item:
    """A capture that is to be done."""

    request: client.Request  # the reconstruction
    need: int  # bytes of memory it is taken to need
    standing: Standing  # where it stands
    tries: int = 0  # how often it was started


@dataclass(slots=True)
class LocalBatch:
    """A batch at work."""

    paths: LibraryPaths  # the library
    items: Sequence[Item]  # in the plan's order; those done before are marked so
    limits: Limits  # see `Limits`
    program: Sequence[str]  # words before those of a request, such as PYTHON -P -m robir
    _waiting: list[Item] = field(default_factory=list)
    _running: list[Item] = field(default_factory=list)

    def run(self, watch: Callable[[], None]) -> None:
        """Do what is not done yet; `watch` follows each look; `CancelledError` if told to stop."""
        for item in self.items:
            is_live = client.snapshot(item.request.out).is_live
            if is_live:  # left by a batch that was killed
                item.tries = 1
                self._running.append(item)
            elif item.standing.state == "waiting":
                self._waiting.append(item)
        try:
            while self._waiting or self._running:
                self._drop()
                self._reorder()
                while (item := self._next()) is not None:
                    self._start(item)
                self._look()
                watch()
                if self._running:
                    time.sleep(_PERIOD)
        finally:
            self._end()

    def _next(self) -> Item | None:
        """The first that there is room for; one that needs more than there is runs alone."""
        free = self.limits.memory - sum(item.need for item in self._running)
        for item in self._waiting if len(self._running) < self.limits.jobs else ():
            if item.need <= free or not self._running:
                return item
        return None

    def _start(self, item: Item) -> None:
        together = min(self.limits.jobs, len(self._waiting) + len(self._running))
        self._waiting.remove(item)
        item.tries += 1
        name = item.standing.name
        environment = worker_environment(self.limits.cores // together)
        with stop_held():
            try:
                client.start(self.program, item.request, environment)
            except client.START_ERRORS as error:
                fault = {"message": str(error), "exit_code": error.exit_code}
                self._settle(item, Standing(name=name, state="failed", **fault))
            else:
                item.standing = Standing(name=name, state="running", message="starting")
                self._running.append(item)

    def _look(self) -> None:
        for item in list(self._running):
            found = of_snapshot(item.standing.name, client.snapshot(item.request.out))
            if found.state == "running":
                item.standing = found
            else:
                self._running.remove(item)
                self._settle(item, found)

    def _settle(self, item: Item, found: Standing) -> None:
        """Note how a process ended, and try once more what may have been the machine's fault."""
        item.standing = found
        if found.state == "failed" and item.tries < _TRIES and found.exit_code not in _FINAL:
            if found.exit_code in _HUNGRY:
                item.need = max(item.need, self.limits.memory)
            item.standing = Standing(
                name=found.name, state="waiting", message=f"once more, after: {found.message}"
            )
            self._waiting.append(item)

    def _drop(self) -> None:
        """Leave out what the user has dropped meanwhile."""
        folder = self.paths.dropped
        names = {file.name for file in folder.iterdir()} if folder.is_dir() else set()
        for item in [*self._waiting, *self._running] if names else ():
            if item.standing.name not in names:
                continue
            if item in self._waiting:
                self._waiting.remove(item)
                item.standing = Standing(name=item.standing.name, state="dropped")
            else:
                item.tries = _TRIES
                client.request_cancel(item.request.out)

    def _reorder(self) -> None:
        """Let come first what the user prefers; the rest stays in the plan's order."""
        first = preferred(self.paths)
        if first:
            place = {name: number for number, name in enumerate(first)}
            self._waiting.sort(key=lambda item: place.get(item.standing.name, len(first)))

    def _end(self) -> None:
        """End in good order what is still at work, and by force what does not."""
        for is_forced in (False, True):
            for item in self._running:
                client.stop(item.request.out, is_forced=is_forced)
            until = time.monotonic() + _PATIENCE
            while self._running and time.monotonic() < until:
                self._running = [
                    item for item in self._running if client.snapshot(item.request.out).is_live
                ]
                time.sleep(_PERIOD if self._running else 0.0)


def worker_environment(cores: int | None = None) -> dict[str, str]:
    """Variables of a process: cores, None for all, and one thread for libraries unless told."""
    share = {} if cores is None else {CORES: str(max(1, cores))}
    return {"OMP_NUM_THREADS": "1", **os.environ, **share}


_BASE = 700 << 20
_BYTES_PER_CELL = 145
_BYTES_PER_TEXEL = 125
_BYTES_PER_FURTHER_TEXEL = 45
_FEW_TEXELS = 4096**2
_BYTES_PER_PIXEL = 8
_BYTES_PER_RAY = 16

_SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".webp", ".bmp", ".heic", ".dng")
_FRAMES = 60  # photographs that a video is taken to give


def memory_needed(plan: Plan, entry: Entry) -> int:
    """Bytes of main memory; what the plan says goes before the estimate."""
    if entry.memory:
        return parse_size(entry.memory)
    config = entry.config()
    cells = max(config.geometry.level_cells) ** 3
    texels = config.appearance.texture_size**2
    pixels = _photographs(plan, entry) * config.capture.max_side**2
    rays = config.transport.num_surfels * config.transport.num_directions
    further = max(0, texels - _FEW_TEXELS)
    textures = (texels - further) * _BYTES_PER_TEXEL + further * _BYTES_PER_FURTHER_TEXEL
    largest = max(cells * _BYTES_PER_CELL, rays * _BYTES_PER_RAY, textures)
    return _BASE + largest + pixels * _BYTES_PER_PIXEL


def _photographs(plan: Plan, entry: Entry) -> int:
    """Pictures in the capture, masks and truth left out; a video's frames are guessed."""
    source = plan.captures / entry.path
    if source.is_file() and source.suffix.lower() not in (".json", ".npz", ".npy"):
        return _FRAMES
    count = 0
    for _, folders, names in os.walk(source if source.is_dir() else source.parent):
        folders[:] = [name for name in folders if name not in ("truth", "masks")]
        count += sum(name.lower().endswith(_SUFFIXES) for name in names)
    return count
