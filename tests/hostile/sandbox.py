# SPDX-License-Identifier: Apache-2.0
"""One call in a process of its own, and whether it kept the promises made about hostile files.

No traceback, at most 15 seconds and 2 GB, no program started, nothing written outside the folder
for temporary files. What is loaded once is shared by all processes, so each costs only itself.
"""

from __future__ import annotations

import os
import signal
import sys
import tempfile
import threading
import time
import traceback
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

MAX_SECONDS = 15.0
MAX_BYTES = 2_000_000_000
# seconds of the clock after which a call counts as hung; a starved one had done 2 s in 60
_PATIENCE = 600.0

_PROGRAMS = ("subprocess.Popen", "os.exec", "os.posix_spawn", "os.system", "os.fork")
_CHANGES = (
    "os.rename", "os.remove", "os.mkdir", "os.rmdir", "os.link", "os.symlink", "os.truncate",
    "os.chmod",
)  # fmt: skip
_IN_FOLDER = ("os.rename", "os.remove", "os.mkdir", "os.rmdir")
_BUG = 99


@dataclass(frozen=True, slots=True)
class Outcome:
    """What a call did."""

    code: int  # exit code
    seconds: float  # processor time
    peak_bytes: int  # largest resident size
    said: str  # what it printed
    faults: tuple[str, ...]  # promises that it broke, as words; empty for a good one


def tried(
    call: Callable[[], int], codes: Sequence[int], homes: Sequence[Path] = (), program: str = "NONE"
) -> Outcome:
    """Call in a fork.

    Args:
        call: Returns the exit code of a command.
        codes: Exit codes that are no fault.
        homes: Folders that may be written to, besides that for temporary files.
        program: Word in the command of the one program that may be started.
    """
    with (
        tempfile.TemporaryDirectory(prefix="robir-try-") as folder,
        tempfile.TemporaryFile() as log,
    ):
        sys.stdout.flush()
        sys.stderr.flush()
        child = os.fork()
        if not child:
            _work(call, log.fileno(), Path(folder), homes)
        hung = threading.Timer(_PATIENCE, _killed, [child])
        hung.start()
        start = time.monotonic()
        _, status, usage = os.wait4(child, 0)
        hung.cancel()
        wall = time.monotonic() - start
        log.seek(0)
        said = log.read(1 << 20).decode("utf-8", errors="replace")
    code = os.waitstatus_to_exitcode(status)
    seconds, peak = usage.ru_utime + usage.ru_stime, 1024 * usage.ru_maxrss
    faults = [
        line
        for line in said.splitlines()
        if line.startswith("WROTE") or (line.startswith("STARTED") and program not in line)
    ]
    if code not in codes:
        faults.append(f"ended with {code}")
    if any(word in said for word in ("Traceback", "Warning:", "internal error")):
        faults.append("a traceback, an internal error or a bare warning")
    if seconds > MAX_SECONDS or wall >= _PATIENCE:
        faults.append(f"took {seconds:.0f} s of the processor, {wall:.0f} of the clock")
    if peak > MAX_BYTES:
        faults.append(f"took {peak / 1e9:.1f} GB")
    return Outcome(code, seconds, peak, said, tuple(faults))


def _killed(process: int) -> None:
    with suppress(ProcessLookupError):
        os.kill(process, signal.SIGKILL)


def _work(call: Callable[[], int], log: int, temporary: Path, homes: Sequence[Path]) -> None:
    """The child: watched by Python's audit hook, never to come back."""
    code = _BUG
    try:
        os.dup2(log, 1)
        os.dup2(log, 2)
        sys.stdout = sys.stderr = os.fdopen(1, "w", errors="backslashreplace", closefd=False)
        tempfile.tempdir = str(temporary)
        allowed = [os.path.realpath(home) for home in (temporary, *homes)]
        sys.addaudithook(lambda event, words: _watched(event, words, allowed))
        code = call()
    except BaseException:
        traceback.print_exc()
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)


def _watched(event: str, words: Sequence[Any], allowed: Sequence[str]) -> None:
    if event in _PROGRAMS:
        os.write(1, f"STARTED {event} {words!a}\n".encode())
    elif event == "open":
        path, _, flags = words
        is_written = isinstance(flags, int) and flags & (os.O_WRONLY | os.O_RDWR | os.O_CREAT)
        if is_written and not _is_inside(path, allowed):
            os.write(1, f"WROTE {path!a}\n".encode())
    elif event in _CHANGES:
        last = words[-1]  # the folder of names that are no paths; -1 where they are
        folder = last if event in _IN_FOLDER and isinstance(last, int) and last >= 0 else None
        paths = [word for word in words if isinstance(word, str | bytes | os.PathLike)]
        if not all(_is_inside(path, allowed, folder) for path in paths):
            os.write(1, f"WROTE {event} {words!a}\n".encode())


def _is_inside(path: Any, allowed: Sequence[str], folder: int | None = None) -> bool:
    if isinstance(path, int) or path == os.devnull:
        return True
    home = "." if folder is None else Path(f"/proc/self/fd/{folder}").readlink()
    real = os.path.realpath(os.path.join(home, os.fsdecode(path)))  # noqa: PTH118
    return any(real == home or real.startswith(home + os.sep) for home in allowed)
