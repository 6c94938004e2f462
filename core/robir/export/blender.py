# SPDX-License-Identifier: Apache-2.0
"""Runs the add-on's headless command in a process of its own; this is all the core knows of it.

Blender is the `bpy` wheel of this environment, or, where the environment variable ROBIR_BLENDER
names an executable, that Blender with the extension. ROBIR_ADDON is the extension's module there;
naming it spares the user to save preferences first.
"""

from __future__ import annotations

import importlib.util
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from robir.errors import CancelledError, DeviceError, RobirError, StorageError, UsageError
from robir.workers import num_workers

_ERRORS: dict[int, type[RobirError]] = {
    error.exit_code: error for error in (UsageError, DeviceError, CancelledError, StorageError)
}

_EXECUTABLE = "ROBIR_BLENDER"
_ADDON = "ROBIR_ADDON"
_COMMAND = "robir_scene"
_PATIENCE = 20.0  # seconds that Blender may take to end after its last report
_FOLLOWED = "ROBIR_FOLLOWED"  # tells the command to end when its standard input does
_THREADS = "OMP_NUM_THREADS"  # tells Blender how many cores there are for it
CURE = "install it with: pip install 'bpy>=4.5,<5.1' (Python 3.11), then run again with --resume"


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """What a headless command did."""

    files: tuple[Path, ...]  # what it wrote
    notes: tuple[str, ...]  # sentences for the user
    wall: float  # seconds on the clock
    cpu: float  # user plus system seconds


def missing_blender() -> str | None:
    """A sentence on what is missing for Blender work, or None if nothing is."""
    executable = os.environ.get(_EXECUTABLE)
    if executable:
        if shutil.which(executable):
            return None
        return f"{_EXECUTABLE} names {executable}, which is no program; correct or unset it"
    if importlib.util.find_spec("bpy") is None:
        return f"Blender's Python module bpy is not installed; {CURE}"
    if importlib.util.find_spec("robir_addon") is None:
        return "the package robir_addon is not importable; run from a checkout of RobIR"
    return None


def run_headless(arguments: Sequence[str], on_progress: Callable[[float, str], None]) -> Outcome:
    """Run `python -m robir_addon.headless ARGUMENTS`; files written, notes and the time it took.

    `on_progress` gets each fraction in [0, 1] and message; what it raises stops the process and is
    raised again. `DeviceError` if Blender is missing or died; `RobirError` with the command's own
    sentence if it failed, or if it said nothing at all.
    """
    missing = missing_blender()
    if missing is not None:
        raise DeviceError(missing)
    command, environment = _command(arguments)
    start, before = time.monotonic(), os.times()
    last: dict[str, Any] = {}
    how: dict[str, Any] = {"text": True, "encoding": "utf-8", "errors": "replace"}
    how["env"] = {**environment, _FOLLOWED: "1", _THREADS: str(num_workers())}
    with (
        tempfile.TemporaryFile("w+", encoding="utf-8", errors="replace") as complaints,
        subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=complaints, **how
        ) as process,
    ):
        try:
            for line in process.stdout or ():
                report = _report(line)
                if "progress" in report:
                    on_progress(report["progress"], report["message"])
                last = report or last
            if process.stdin:
                process.stdin.close()
        except BaseException:
            process.terminate()
            _end_of(process, is_told=True)
            raise
        code = _end_of(process, is_told="files" in last)
        complaints.seek(0)
        sentence = _sentence(complaints.read())
    if code != 0:
        unknown: type[RobirError] = DeviceError if code < 0 else RobirError
        kind = _ERRORS.get(code, unknown)
        raise kind(sentence or f"Blender ended with code {code}; try again")
    if "files" not in last:
        raise RobirError("Blender ended without a word about what it wrote")
    after = os.times()
    return Outcome(
        files=tuple(Path(file) for file in last.get("files", ())),
        notes=tuple(last.get("notes", ())),
        wall=time.monotonic() - start,
        cpu=sum(after[2:4]) - sum(before[2:4]),  # of children
    )


def _end_of(process: subprocess.Popen[str], *, is_told: bool) -> int:
    """Exit code of a process that has closed its reports; one that hangs is ended."""
    try:
        return process.wait(_PATIENCE)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
        return 0 if is_told else DeviceError.exit_code


def _command(arguments: Sequence[str]) -> tuple[list[str], dict[str, str]]:
    """The command line and the environment variables of a headless command."""
    executable = os.environ.get(_EXECUTABLE)
    if executable:
        addon = os.environ.get(_ADDON, "bl_ext.user_default.robir")
        start = [executable, "--background", "--disable-autoexec", "--addons", addon]
        start += ["--command", _COMMAND]
        return [*start, *arguments], dict(os.environ)
    # -P: what this process imports decides, not what lies in the current folder
    start = [sys.executable, "-P", "-m", "robir_addon.headless"]
    # an imported bpy adds its own scripts, which would stand in front of it
    folders = _folders_of_blender(sys.modules.get("bpy"))
    entries = [Path(entry).absolute() for entry in sys.path]
    kept = [e for e in entries if not any(e.is_relative_to(folder) for folder in folders)]
    search_path = os.pathsep.join(map(str, kept))
    return [*start, *arguments], {**os.environ, "PYTHONPATH": search_path}


def _folders_of_blender(bpy: Any) -> list[Path]:
    """Where an imported Blender keeps its scripts and the user's; none without one."""
    if bpy is None:
        return []
    found = [bpy.utils.resource_path(kind) for kind in ("USER", "LOCAL", "SYSTEM")]
    return [Path(folder) for folder in found if folder]


def _report(line: str) -> dict[str, Any]:
    """The report in a line; empty where a whole Blender says something of its own."""
    if not line.startswith("{"):
        return {}
    try:
        return json.loads(line)
    except ValueError:
        return {}


def _sentence(complaints: str) -> str:
    """The command's own sentence among what was said on standard error, else the last line."""
    lines = complaints.strip().splitlines() or [""]
    if any(line.startswith("Unrecognized command") for line in lines):
        return f"the Blender that {_EXECUTABLE} names has no RobIR extension; install it there"
    ours = [line.removeprefix("error: ") for line in lines if line.startswith("error: ")]
    return (ours or lines)[-1]
