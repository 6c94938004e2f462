# SPDX-License-Identifier: Apache-2.0
"""Short shares of what `make hostile` does for hours, on a real run of all stages.

`tests/batch/test_real.py` kills workers and fills a disk, `tests/pipeline/test_workers.py` takes
the mark of a stage away.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from hostile.corpus import judged
from hostile.leaks import growth
from hostile.mutants import corpus
from hostile.sandbox import tried

ROOT = Path(__file__).parents[2]

FORKS = pytest.mark.skipif(not hasattr(os, "fork"), reason="takes fork")


def run(*words: str) -> str:
    """The last line that a harness prints; it has to end well."""
    command = [sys.executable, "-m", *words]
    search = os.pathsep.join(map(str, (ROOT / "core", ROOT, ROOT / "tests")))
    environment = os.environ | {"PYTHONPATH": search, "OMP_NUM_THREADS": "1"}
    done = subprocess.run(command, capture_output=True, text=True, env=environment, check=False)
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-3000:]
    return done.stdout.splitlines()[-1]


@FORKS
@pytest.mark.slow
def test_mutated_captures_keep_the_promises():
    assert "0 broke a promise" in run("hostile.corpus", "0", "1", "1/6")


@FORKS
@pytest.mark.slow
def test_forged_results_keep_the_promises():
    assert " 0 broke a promise" in run("hostile.forged", "0", "4")


def test_growth_is_between_the_second_and_the_last_quarter():
    assert growth([50, 60, 100, 100, 100, 100, 101, 101]) == pytest.approx(0.01)


def forbidden(folder: Path) -> dict[str, tuple]:
    return {
        "a program": (lambda: os.system("true"), "STARTED"),
        "a file": (lambda: (folder / "x").write_text(""), "WROTE"),
        "a folder": (lambda: (folder / "d").mkdir(), "WROTE"),
        "a removal": (lambda: (folder / "there").unlink(), "WROTE"),
        "a crash": (lambda: 1 // 0, "traceback"),
        "a code": (lambda: 1, "ended with 1"),
        "a signal": (lambda: os.kill(os.getpid(), signal.SIGKILL), "ended with -9"),
    }


@FORKS
@pytest.mark.parametrize("what", forbidden(Path()))
def test_a_broken_promise_is_noticed(tmp_path, what):
    (tmp_path / "there").touch()
    call, expected = forbidden(tmp_path)[what]
    outcome = tried(lambda: call() or 0, (0,))
    assert any(expected in fault for fault in outcome.faults), outcome
    assert not tried(lambda: 0, (0,)).faults


@FORKS
def test_what_takes_too_much_memory_or_time_is_noticed(monkeypatch):
    monkeypatch.setattr("hostile.sandbox.MAX_BYTES", 10_000_000)
    assert any("GB" in fault for fault in tried(lambda: 0, (0,)).faults)
    monkeypatch.setattr("hostile.sandbox._PATIENCE", 0.2)
    start = time.monotonic()
    assert any("took" in fault for fault in tried(lambda: time.sleep(600) or 0, (0,)).faults)
    assert time.monotonic() - start < 300


def test_cells_that_coincide_as_numbers_are_not_divided_for_minutes():
    """Poses on shifted lines: the masks' hull was a point, of ever more cells."""
    name = "colmap_text-lines-3"
    mutants = [mutant for mutant in corpus(91, 4) if mutant.name == name]
    ((_, outcome),) = judged(mutants)
    assert not outcome.faults, outcome.faults
