# SPDX-License-Identifier: Apache-2.0
"""Runs the add-on's headless command in a process of its own; this is all the core knows of it."""

from __future__ import annotations

import importlib.util
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from robir.errors import CancelledError, DeviceError, RobirError, UsageError

_ERRORS: dict[int, type[RobirError]] = {
    error.exit_code: error for error in (UsageError, DeviceError, CancelledError)
}

CURE = "install it with: pip install 'bpy>=4.5,<5.1' (Python 3.11), then run again with --resume"


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """What a headless command did.

    Attributes:
        files: What it wrote.
        notes: Sentences for the user.
        wall: Seconds on the clock.
        cpu: User plus system seconds.
    """

    files: tuple[Path, ...]
    notes: tuple[str, ...]
    wall: float
    cpu: float


def missing_blender() -> str | None:
    """A sentence on what is missing for Blender work, or None if nothing is."""
    if importlib.util.find_spec("bpy") is None:
        return f"Blender's Python module bpy is not installed; {CURE}"
    if importlib.util.find_spec("robir_addon") is None:
        return "the package robir_addon is not importable; run from a checkout of RobIR"
    return None


def run_headless(arguments: Sequence[str], on_progress: Callable[[float, str], None]) -> Outcome:
    """Run `python -m robir_addon.headless ARGUMENTS` and follow its progress.

    Args:
        arguments: Command, result folder and options.
        on_progress: Called with each fraction in [0, 1] and message; what it raises stops the
            process and is raised again.

    Returns:
        Files written, notes and the time it took.

    Raises:
        DeviceError: If Blender is missing or died.
        RobirError: With the command's own sentence if it failed.
    """
    missing = missing_blender()
    if missing is not None:
        raise DeviceError(missing)
    # -P: what this process imports decides, not what lies in the current folder
    command = [sys.executable, "-P", "-m", "robir_addon.headless", *arguments]
    search_path = os.pathsep.join(str(Path(entry).absolute()) for entry in sys.path)
    start, before = time.monotonic(), os.times()
    last: dict[str, list[str]] = {}
    with (
        tempfile.TemporaryFile("w+", encoding="utf-8", errors="replace") as complaints,
        subprocess.Popen(
            command,
            stdout=subprocess.PIPE,
            stderr=complaints,
            text=True,
            encoding="utf-8",
            env={**os.environ, "PYTHONPATH": search_path},
        ) as process,
    ):
        try:
            for line in process.stdout or ():
                report = json.loads(line)
                if "progress" in report:
                    on_progress(report["progress"], report["message"])
                last = report
        except BaseException:
            process.terminate()
            raise
        code = process.wait()
        complaints.seek(0)
        sentence = (complaints.read().strip().splitlines() or [""])[-1].removeprefix("error: ")
    if code != 0:
        unknown: type[RobirError] = DeviceError if code < 0 else RobirError
        kind = _ERRORS.get(code, unknown)
        raise kind(sentence or f"Blender ended with code {code}")
    after = os.times()
    return Outcome(
        files=tuple(Path(file) for file in last.get("files", ())),
        notes=tuple(last.get("notes", ())),
        wall=time.monotonic() - start,
        cpu=after.children_user
        + after.children_system
        - before.children_user
        - before.children_system,
    )
