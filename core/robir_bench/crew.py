# SPDX-License-Identifier: Apache-2.0
"""The runs of a bench side by side on this machine, each a process.

A run starts once those that it borrows stages from have ended, well or not, so what comes out is
what comes out of one after another.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from robir.jobs.client import detached
from robir.pipeline.device import Usage
from robir.pipeline.faults import stop_held, stop_requested
from robir.workers import CORES, available_cores
from robir_bench.plan import BenchRun
from robir_bench.runs import Scores, last_line, out_of_budget, read_scores, waits_for

_PERIOD = 0.2  # seconds between two looks at what is at work


@dataclass(slots=True, kw_only=True)
class Crew:
    """Does runs on this machine, several at a time."""

    runs: Sequence[BenchRun]  # what to do, in order
    folder: Path  # of the results and `scores.jsonl`
    jobs: int  # most at a time
    command: Sequence[str]  # words that do the run whose number follows, and leave its record
    say: Callable[[str], None]  # takes a line about each run
    _running: dict[int, subprocess.Popen[Any]] = field(default_factory=dict)

    def work(self, budget: float | None) -> None:
        """Do every run that has no score yet; one that fails is recorded and stops nothing.

        Args:
            budget: CPU seconds that this call may take, or None; as for `carry_out`.

        Raises:
            CancelledError: If it is told to stop; what is at work is ended in good order.
        """
        scores, waits = Scores(self.folder, self.runs), waits_for(self.runs)
        todo, begin, ended, used, is_spent = scores.missing, Usage.now(), 0, 0.0, False
        try:
            with stop_requested():
                while self._running or (todo and not is_spent):
                    used = Usage.now().seconds_since(begin)["cpu"]
                    for number in list(todo):
                        expected = used / max(ended, 1) * (len(self._running) + 1)
                        is_spent = budget is not None and used + expected * (ended > 0) >= budget
                        if is_spent or len(self._running) >= self.jobs:
                            break
                        if not waits[number] & {*todo, *self._running}:
                            todo.remove(number)
                            self._start(number)
                    ended += self._look(scores)
        finally:
            self._end()
        if is_spent and budget is not None and todo:
            self.say(out_of_budget(used, budget, scores))

    def _log(self, number: int) -> Path:
        return self.folder / "records" / f"{self.runs[number].name}.log"

    def _start(self, number: int) -> None:
        self._log(number).parent.mkdir(parents=True, exist_ok=True)
        with self._log(number).open("wb") as log, stop_held():
            self._running[number] = subprocess.Popen(
                [*self.command, str(number)],
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                env=os.environ | {CORES: str(max(1, available_cores() // self.jobs))},
                **detached(),
            )

    def _look(self, scores: Scores) -> int:
        """Record what has ended; how many that are."""
        time.sleep(_PERIOD)
        over = [number for number in self._running if self._running[number].poll() is not None]
        for number in over:
            code, run = self._running.pop(number).returncode, self.runs[number]
            record = read_scores(self.folder).get(run.name)
            if code or record is None:
                said = last_line(self._log(number).read_text(encoding="utf-8", errors="replace"))
                record = run.facts | {"error": said, "exit_code": max(code, 1)}
            scores.keep(record)
            self._log(number).unlink()
            self.say(f"{number + 1}/{len(self.runs)} {run.name}: {record.get('error', 'done')}")
        return len(over)

    def _end(self) -> None:
        """End what is still at work, and what that has started."""
        for process in self._running.values():
            with suppress(ProcessLookupError):
                if sys.platform == "win32":
                    process.terminate()
                else:
                    os.killpg(process.pid, signal.SIGTERM)
        for process in self._running.values():
            process.wait()
        self._running.clear()
