# SPDX-License-Identifier: Apache-2.0
"""Benches side by side and on farms: the same scores, and lenders of stages before borrowers."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
from bench.fake_robir import FakeRobir, write_plan

from robir import cli
from robir.errors import CancelledError
from robir.jobs.paths import read_json
from robir_bench import runs as bench_runs
from robir_bench.ablation import ablated, trials
from robir_bench.crew import Crew
from robir_bench.paper.config import VARIANTS
from robir_bench.plan import METHODS, OURS, BenchRun, read_plan, read_sweep
from robir_bench.runs import Scores, carry_out, read_scores, scores_file, waits_for

ROOT = Path(__file__).parents[2]


def plan_of(folder: Path, *captures: object) -> Path:
    """Two methods of each capture, as it is and with one factor."""
    names = json.dumps(list(map(str, captures)))
    methods = '["ours", "no visibility"]'
    return write_plan(folder, f"captures = {names}\nmethods = {methods}\n[factors]\nnoise = [0.1]")


@pytest.fixture(scope="module")
def one_by_one(tmp_path_factory, capture) -> tuple[Path, Path]:
    """A plan and the scores of its runs one after another; half of them fail."""
    place = tmp_path_factory.mktemp("alone")
    plan, folder = plan_of(place, capture, "bad"), place / "one"
    runs = read_sweep(plan, folder)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(bench_runs, "_robir", FakeRobir())
        carry_out(runs, folder, None, lambda _line: None, is_truth_needed=True)
    assert len(read_scores(folder)) == len(runs) == 8
    return plan, scores_file(folder)


class Team:
    """Runs done side by side by tasks that only copy their records."""

    def __init__(self, folder: Path, plan: Path, scores: Path) -> None:
        self.out, self.notes, self.said = folder / "many", folder / "notes", []
        self.runs: list[BenchRun] = read_sweep(plan, self.out)
        self.program = [
            sys.executable,
            "-I",
            "-S",
            str(Path(__file__).with_name("copying_task.py")),
        ]
        self.program += [str(self.notes), str(scores)]
        self.words = ["stability", str(plan), "-o", str(self.out), "--task"]

    def crew(self, *runs: BenchRun, command: list[str] | None = None) -> Crew:
        return Crew(
            runs=runs or self.runs, folder=self.out, jobs=3,
            command=command or [*self.program, *self.words], say=self.said.append,
        )  # fmt: skip

    def moments(self) -> dict[tuple[str, int], float]:
        lines = [line.split() for line in self.notes.read_text().splitlines()]
        return {(kind, int(number)): float(moment) for kind, number, moment in lines}


def in_order(moments: dict[tuple[str, int], float], runs: list[BenchRun]) -> bool:
    """Whether nothing began before what it waits for had ended."""
    return all(
        moments["end", other] <= moments["begin", number]
        for number, before in enumerate(waits_for(runs))
        for other in before
    )


def test_borrowers_wait_for_their_lenders(tmp_path):
    names = json.dumps(list(METHODS))
    runs = read_plan(write_plan(tmp_path, f'captures = ["a", "b"]\nmethods = {names}'))
    for number, before in enumerate(waits_for(runs)):
        run = runs[number]
        assert {runs[other].capture for other in before} <= {run.capture}
        earlier = {other.method for other in runs[:number] if other.capture == run.capture}
        shared = {OURS} | (earlier & set(VARIANTS) if run.method in VARIANTS else set())
        assert {runs[other].method for other in before} == shared - {run.method}
    # of an ablation each run waits for the whole one alone
    left_out = ablated(runs[:1], trials())
    assert waits_for(left_out) == [set(), *[{0}] * (len(left_out) - 1)]


def test_side_by_side_gives_the_same_file(tmp_path, one_by_one):
    team = Team(tmp_path, *one_by_one)
    team.crew().work(None)
    assert scores_file(team.out).read_bytes() == one_by_one[1].read_bytes()
    assert not list((team.out / "records").iterdir())
    assert len(team.said) == 8
    moments = team.moments()
    assert in_order(moments, team.runs)
    assert moments["begin", 2] < moments["end", 0]  # what need not wait did not


def test_a_task_that_dies_is_recorded_and_the_next_call_does_only_that(tmp_path, one_by_one):
    team = Team(tmp_path, *one_by_one)
    good = team.runs[:2]
    dying = "import os; print('cut', flush=True); os.kill(os.getpid(), 9)"
    team.crew(*good, command=[sys.executable, "-c", dying]).work(None)
    records = read_scores(team.out).values()
    assert [(record["error"], record["exit_code"]) for record in records] == [("cut", 1)] * 2
    team.crew(*good).work(0.0)
    assert "2 runs are left" in team.said[-1] and not team.notes.exists()
    team.crew(good[0]).work(None)
    assert Scores(team.out, good).missing == [1]
    team.crew(*good).work(None)
    assert Scores(team.out, good).missing == []
    assert [number for kind, number in team.moments() if kind == "begin"] == [0, 1]


def test_a_farm_gets_lenders_first_and_only_what_is_missing(tmp_path, one_by_one, robir, capsys):
    team = Team(tmp_path, *one_by_one)
    team.crew(team.runs[0]).work(None)  # done before, so that its borrower need not wait
    words = team.words[:-1]
    assert cli.main([*words, "--on", "openjd"]) == 0
    bundle = Path(capsys.readouterr().out.strip())
    *steps, _ = read_json(bundle / "template.json")["steps"]
    spaces = [step["parameterSpace"]["taskParameterDefinitions"][0]["range"] for step in steps]
    assert spaces == ["1-2,4,6", "3,5,7"]
    text = "".join(file.read_text() for file in bundle.iterdir())
    assert str(tmp_path) not in text and str(one_by_one[0].parent) not in text
    assert cli.main([*words, "--on", "openjd", "--budget", "9"]) == 2
    assert cli.main([*words, "--task", "8"]) == 2
    farmed(bundle, team)
    assert scores_file(team.out).read_bytes() == one_by_one[1].read_bytes()
    assert in_order(team.moments(), team.runs)
    assert "noise" in (team.out / "stability.md").read_text()


def farmed(bundle: Path, team: Team) -> None:
    """Run a bundle here, with a Python whose tasks only copy; the page is the real program's."""
    program = Path(sys.executable).with_name("openjd")
    if not program.exists():
        pytest.skip("RENDER FARMS NOT TESTED: openjd-cli is not installed (pip install openjd-cli)")
    python = team.out.with_name("python")
    copying, real = " ".join(team.program), f"{sys.executable} -m robir"
    choice = f'case "$*" in *--task*) exec {copying} "$@";; *) exec {real} "$@";; esac'
    python.write_text(f"#!/bin/sh\nshift 3\n{choice}\n")
    python.chmod(0o755)
    values = read_json(bundle / "parameter_values.json")["parameterValues"]
    places = [f"{value['name']}={(bundle / value['value']).resolve()}" for value in values]
    given = [word for place in (*places, f"Python={python}") for word in ("-p", place)]
    command = [str(program), "run", str(bundle / "template.json"), "--step", "Page"]
    done = subprocess.run(
        [*command, "--run-dependencies", *given], capture_output=True, text=True, env=variables()
    )
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-2000:]


def variables() -> dict[str, str]:
    return {**os.environ, "PYTHONPATH": f"{ROOT / 'core'}{os.pathsep}{ROOT}"}


def test_a_crew_that_is_told_to_stop_ends_its_tasks_and_what_they_started(tmp_path, one_by_one):
    team = Team(tmp_path, *one_by_one)
    mark = tmp_path / "begun"
    sleeping = f"sleep 600 & echo $! > {mark}; wait"
    crew = team.crew(team.runs[0], command=["/bin/sh", "-c", sleeping])
    stopper = threading.Thread(target=stop_once, args=(mark,))
    stopper.start()
    with pytest.raises(CancelledError):
        crew.work(None)
    stopper.join()
    child = Path("/proc", mark.read_text().strip(), "stat")
    # it has its signal, and on a busy machine yet to take it
    patience = time.monotonic() + 120.0
    while is_running(child) and time.monotonic() < patience:
        time.sleep(0.02)
    assert not is_running(child)
    assert Scores(team.out, team.runs[:1]).missing == [0]


def is_running(stat: Path) -> bool:
    """Whether a process, by its file of /proc, is neither gone nor only to be waited for."""
    try:
        return stat.read_text().rpartition(")")[2].split()[0] != "Z"
    except (FileNotFoundError, ProcessLookupError):
        return False


def stop_once(mark: Path) -> None:
    """Ask this process to end once a file is there and says something."""
    while not (mark.exists() and mark.read_text().strip()):
        time.sleep(0.02)
    os.kill(os.getpid(), signal.SIGTERM)
