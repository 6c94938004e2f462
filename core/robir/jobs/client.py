# SPDX-License-Identifier: Apache-2.0
"""Starts a reconstruction that outlives its caller, and follows, stops or finds it again by files.

Whoever knows the result folder can follow the worker: the lock says whether one is at work, as it
goes with the process that holds it, `status.json` says where it stands, and `worker.log` holds what
it printed, which matters where it ended before it could write a status.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

from robir.errors import CancelledError, DeviceError, StorageError, UsageError
from robir.jobs.folder import create, holder, is_full
from robir.jobs.names import open_regular
from robir.jobs.paths import JobPaths, write_json
from robir.jobs.records import check, read_record
from robir.jobs.status import Status, read_status

START_ERRORS = (UsageError, StorageError, DeviceError)  # each a sentence for the user
State = Literal["none", "starting", "running", "done", "failed", "cancelled", "died"]

_STARTING_SECONDS = 120.0  # until a worker that is no child of ours has its lock
_LOG_LINES = 30
_NICENESS = 10

_TAIL_BYTES = 1 << 20

_WORKER = {"started": float, "pid": (None, int), "status_before?": (None, float)}
_RUN = {"warnings?": [{"message": str}]}
_FAILED = {"kind": str, "message?": str, "exit_code?": int}

_children: dict[Path, subprocess.Popen[Any]] = {}  # by result folder


@dataclass(frozen=True, slots=True, kw_only=True)
class Request:
    """What to reconstruct; every path is absolute."""

    capture: Path  # folder or file of the capture
    out: Path  # result folder; an unfinished one is continued
    device: str = "auto"  # "auto", "cpu" or "cuda"
    masks: Path | None = None  # folder of masks, or None for the capture's own
    box: tuple[float, ...] = ()  # where the object is, as `capture.box`; empty to look for it
    skips_missing: bool = False  # whether photographs that are not there are done without
    left_out: tuple[str, ...] = ()  # photographs to do without, as the setting `capture.leave_out`
    mesh: Path | None = None  # mesh that takes the place of a surface of the engine's, or None
    settings: tuple[str, ...] = ()  # further items of `--set`
    asset: Path | None = None  # file of facts of an asset to be made, or None
    until: str = ""  # stage after which the run ends; empty for the last

    def words(self) -> list[str]:
        """The command line without the program."""
        masks = [] if self.masks is None else ["--masks", str(self.masks)]
        choices = ["--device", self.device]
        choices += [] if self.mesh is None else ["--mesh", str(self.mesh)]
        asset = [] if self.asset is None else ["--asset", str(self.asset)]
        until = ["--until", self.until] if self.until else []
        return [
            "reconstruct", str(self.capture), "-o", str(self.out), *choices, *masks, *asset, *until,
            *self.choice_words(), *(word for item in self.settings for word in ("--set", item)),
            # the request says it all: what is in the folder may be of another one, or a stranger's
            "--resume", "--defaults", "--progress", "json",
        ]  # fmt: skip

    def choice_words(self) -> list[str]:
        """What says which photographs take part and where the object is; `check` takes it too."""
        names = json.dumps(self.left_out, ensure_ascii=False)
        return [
            *(["--set", f"capture.box={list(map(float, self.box))}"] if self.box else []),
            *(["--skip-missing"] if self.skips_missing else []),
            *(["--set", f"capture.leave_out={names}"] if self.left_out else []),
        ]


@dataclass(frozen=True, slots=True, kw_only=True)
class Snapshot:
    """Where a reconstruction stands."""

    state: State  # "none" before any run, "died" where the worker ended without a word
    stage: str = ""  # stage at work or last at work; empty before the first
    fraction: float = 0.0  # share of the run that is done, in [0, 1]
    message: str = ""  # what is being done, or the sentence that says why it ended
    seconds_left: float | None = None  # estimated seconds to the end, or None
    metrics: Mapping[str, Any] = field(default_factory=dict)  # latest metrics by name
    exit_code: int | None = None  # of the ended worker, or None where it is not known
    warnings: tuple[str, ...] = ()  # sentences about what lowers the result
    log: tuple[str, ...] = ()  # last lines of the log for people, where the run ended badly

    @property
    def is_live(self) -> bool:
        """Whether a worker is at work."""
        return self.state in ("starting", "running")


def start(program: Sequence[str], request: Request, environment: Mapping[str, str]) -> None:
    """Start a worker, PROGRAM and the request's words, that goes on when this process ends.

    `UsageError` if the folder holds other things or a worker is at work, `StorageError` if nothing
    can be written there, `DeviceError` if the program cannot be run.
    """
    paths = JobPaths(request.out)
    create(paths)
    if not snapshot(request.out).is_live:
        _reap(request.out, 5.0)  # it has said that it is done and may still be going
    at_work = holder(paths.lock)
    if at_work is not None:
        raise UsageError(f"{request.out} is in use by process {at_work}; wait for it or stop it")
    before = _read_status(paths)
    begun: dict[str, Any] = {"started": time.time(), "pid": None}
    # Clocks may be set back, so what is new is told by its being another, not by its being later.
    begun["status_before"] = None if before is None else before.heartbeat
    try:
        paths.cancel.unlink(missing_ok=True)
        write_json(paths.worker, begun)
        words = [*program, *request.words()]
        process = spawn(words, request.out, paths.worker_log, environment)
    except OSError as error:
        if error.filename == program[0]:
            raise DeviceError(
                f"the engine {program[0]} cannot be run: {error.strerror}; check the engine"
            ) from error
        raise StorageError(
            f"{error.filename or request.out} cannot be written: {error.strerror}; make room or "
            "choose another result folder"
        ) from error
    _children[request.out] = process
    if sys.platform != "win32":
        with suppress(OSError):  # the programs in front of the user go first
            os.setpriority(os.PRIO_PROCESS, process.pid, _NICENESS)
    with suppress(OSError):  # the number only helps others to tell a slow start from a death
        write_json(paths.worker, begun | {"pid": process.pid})


def snapshot(root: Path) -> Snapshot:
    """Where the reconstruction in a result folder stands; never raises, whatever is in there."""
    paths = JobPaths(root)
    begun = _read(paths.worker, _WORKER)
    status = _read_status(paths)
    while True:
        is_held = holder(paths.lock) is not None
        before, status = status, _read_status(paths)
        # A worker that has just begun or ended did so between two looks; a dead one stays dead.
        if is_held or status == before:
            break
    if not begun and status is None and not is_held:
        return Snapshot(state="none")
    is_current = status is not None and status.heartbeat != begun.get("status_before")
    if status is not None and is_current:
        shared = ("stage", "fraction", "message", "seconds_left", "metrics")
        known = Snapshot(state="running", **{key: getattr(status, key) for key in shared})
        if status.state != "running":
            _reap(root, 0.0)
            return _ended(paths, known, status.state, status.message, status.exit_code)
        if is_held:
            return known
    elif is_held or _is_starting(root, begun):
        return Snapshot(state="starting", message="starting")
    else:
        known = Snapshot(state="running")
    return _without_a_word(paths, known, _reap(root, 0.2))


def request_cancel(root: Path) -> None:
    """Ask the worker to stop at its next step; one that has not begun is ended at once."""
    paths = JobPaths(root)
    paths.cancel.touch()
    if snapshot(root).state == "starting":
        stop(root)


def stop(root: Path, *, is_forced: bool = False) -> None:
    """End the worker at once, or by force with its children, which gives it no time for order."""
    child = _children.get(root)
    # The lock names the process that holds it, so no stranger with a used-up number is hit.
    pid = holder(JobPaths(root).lock) or (child.pid if child and child.poll() is None else None)
    if pid is None:
        return
    try:
        if not is_forced or sys.platform == "win32":
            os.kill(pid, signal.SIGTERM)
        elif os.getpgid(pid) == pid:
            os.killpg(pid, signal.SIGKILL)
        else:
            os.kill(pid, signal.SIGKILL)
    except ProcessLookupError:
        pass  # it was faster


def detached() -> dict[str, Any]:
    """What keeps a worker alive when its starter ends."""
    if sys.platform == "win32":
        flags = subprocess.CREATE_NO_WINDOW | subprocess.CREATE_NEW_PROCESS_GROUP
        return {"creationflags": flags | subprocess.BELOW_NORMAL_PRIORITY_CLASS}
    return {"start_new_session": True}


def spawn(
    words: Sequence[str], folder: Path, log: Path, environment: Mapping[str, str]
) -> subprocess.Popen[Any]:
    """Start a process in a folder that goes on when this one ends, and prints to a log."""
    how = detached() | {"stdin": subprocess.DEVNULL, "env": dict(environment)}
    with log.open("wb") as file:
        process = subprocess.Popen(
            list(words), stdout=file, stderr=subprocess.STDOUT, cwd=folder, **how
        )
    threading.Thread(target=process.wait, name="RobIR worker", daemon=True).start()
    return process


def _is_starting(root: Path, begun: Mapping[str, Any]) -> bool:
    """Whether a worker that holds no lock yet may still come to it."""
    child = _children.get(root)
    if child is not None:
        return child.poll() is None
    if abs(time.time() - begun.get("started", 0.0)) > _STARTING_SECONDS:
        return False
    if sys.platform == "win32" or begun.get("pid") is None:
        return True
    try:
        os.kill(begun["pid"], 0)
    except OSError as error:
        return isinstance(error, PermissionError)
    except OverflowError:
        return False
    return True


def _reap(root: Path, seconds: float) -> int | None:
    """Exit code of a worker of ours that ends within some seconds, or None; forgets it."""
    child = _children.get(root)
    if child is None:
        return None
    try:
        code = child.wait(seconds)
    except subprocess.TimeoutExpired:
        return None
    del _children[root]
    return code


def _ended(
    paths: JobPaths, known: Snapshot, state: State, message: str, exit_code: int | None
) -> Snapshot:
    found = _read(paths.run, _RUN).get("warnings", ())
    facts: dict[str, Any] = {
        "warnings": tuple(warning["message"] for warning in found),
        "exit_code": exit_code,
    }
    facts["log"] = () if state == "done" else _log_tail(paths)
    return replace(known, state=state, message=message, seconds_left=None, **facts)


def _without_a_word(paths: JobPaths, known: Snapshot, code: int | None) -> Snapshot:
    """What became of a worker that is gone and left no final status."""
    printed = _printed(paths)
    if (failure := _failure(printed)) is not None:
        code = failure["exit_code"]
        state: State = "cancelled" if code == CancelledError.exit_code else "failed"
        return _ended(paths, known, state, failure["message"], code)
    if paths.cancel.exists():
        return _ended(paths, known, "cancelled", "stopped on request", code)
    again = "press Reconstruct to go on from the last finished stage"
    words = [line for line in printed if not line.startswith("{")]
    if is_full(paths.root):
        message = f"the disk of {paths.root} is full; make room, then {again}"
    elif not known.stage and code is not None and code > 0:
        said = words[-1] if words else f"it ended with code {code}"
        message = f"the engine did not start ({said}); check the engine"
    else:
        place = f" in {known.stage}" if known.stage else ""
        why = " by the system, perhaps for want of memory" if code == -9 else ""
        message = f"the worker was killed{place}{why}; {again}"
    return _ended(paths, known, "died", message, code)


def _printed(paths: JobPaths) -> list[str]:
    try:
        return [line for line in _tail(paths.worker_log) if line.strip()]
    except OSError:
        return []


def _tail(path: Path) -> list[str]:
    """The last lines of a log; a whole one may have any length."""
    with os.fdopen(open_regular(path), "rb") as file:
        file.seek(max(0, os.fstat(file.fileno()).st_size - _TAIL_BYTES))
        return file.read(_TAIL_BYTES).decode("utf-8", errors="replace").splitlines()


def _failure(printed: Sequence[str]) -> dict[str, Any] | None:
    for line in reversed(printed):
        try:
            event = json.loads(line)
            check(event, _FAILED, "the worker's last word")
        except (ValueError, RecursionError):
            continue
        if event["kind"] == "failed" and {"message", "exit_code"} <= event.keys():
            return {"message": event["message"], "exit_code": event["exit_code"]}
    return None


def _log_tail(paths: JobPaths) -> tuple[str, ...]:
    try:
        log = _tail(paths.log)
    except OSError:
        log = []
    words = [line for line in _printed(paths) if not line.startswith("{")]
    return tuple([*log, *words][-_LOG_LINES:])


def _read(path: Path, form: Any) -> dict[str, Any]:
    """Contents of a JSON file; nothing where it is missing or damaged."""
    try:
        return read_record(path, form)
    except (OSError, ValueError):
        return {}


def _read_status(paths: JobPaths) -> Status | None:
    try:
        return read_status(paths.status)
    except (OSError, ValueError):
        return None
