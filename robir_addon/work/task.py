# SPDX-License-Identifier: GPL-3.0-or-later
"""A subprocess that prints JSON lines, read without making anyone wait; knows no Blender."""

import os
import queue
import signal
import subprocess
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from typing import IO, Any, cast

from ..engine.errors import AddonError

OnLine = Callable[[dict[str, Any]], None]
OnEnd = Callable[[int, str], None]
_PATIENCE = 5.0  # seconds from the request to end until a task is made to
_IS_WINDOWS = os.name == "nt"
_SAID_LINES = 30


class Task:
    """A subprocess whose standard output and error are read by a thread."""

    def __init__(
        self,
        name: str,
        command: Sequence[str],
        on_line: OnLine,
        on_end: OnEnd,
        environment: Mapping[str, str],
    ) -> None:
        self.name = name
        self.on_line, self.on_end = on_line, on_end
        self.said: deque[str] = deque(maxlen=_SAID_LINES)
        self.stopped_at: float | None = None
        self._lines: queue.SimpleQueue[str | None] = queue.SimpleQueue()
        try:
            self._process = subprocess.Popen(
                [str(word) for word in command],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                encoding="utf-8",
                errors="replace",
                env={**environment, "PYTHONUTF8": "1"},
                creationflags=getattr(subprocess, "CREATE_NO_WINDOW", 0),  # of Windows
                start_new_session=not _IS_WINDOWS,
            )
        except OSError as fault:
            text = "{program} cannot be run: {fault}; check the engine"
            raise AddonError(text, program=command[0], fault=fault.strerror) from fault
        threading.Thread(target=self._read, name=f"RobIR {name}", daemon=True).start()

    def _read(self) -> None:
        with cast("IO[str]", self._process.stdout) as lines:
            for line in lines:
                self._lines.put(line)
        self._lines.put(None)

    def next_line(self, seconds: float) -> str | None:
        """The next line, None at the end; raises queue.Empty where none comes in time."""
        return self._lines.get(timeout=seconds) if seconds else self._lines.get_nowait()

    def end(self) -> tuple[int, str]:
        """Exit code, 130 if it was stopped, and its last words that were no JSON."""
        code = self._process.wait()
        return (130 if self.stopped_at is not None else code), "\n".join(self.said)

    def stop(self) -> None:
        """Tell it to end, and after some seconds make it; may be called again and again."""
        now = time.monotonic()
        if self.stopped_at is None:
            self.stopped_at = now
            self._signal(signal.SIGTERM)
        elif now - self.stopped_at > _PATIENCE:
            self.kill()

    def kill(self) -> None:
        """End it and its own children now."""
        self._signal(signal.SIGTERM if _IS_WINDOWS else signal.SIGKILL)

    def _signal(self, number: int) -> None:
        with suppress(ProcessLookupError):
            if _IS_WINDOWS:
                self._process.terminate()
            else:
                os.killpg(self._process.pid, number)
