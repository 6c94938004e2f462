# SPDX-License-Identifier: Apache-2.0
"""Parts of the stages as tasks of their own: what a farm is asked for, and what each task does."""

from __future__ import annotations

import os
import re

import pytest

from robir.batch.farm import library_job, submit_to_slurm
from robir.errors import UsageError
from robir.jobs.library import LibraryPaths
from robir.jobs.paths import JobPaths, read_json
from tests.batch.fakes import make_captures, run_batch


@pytest.fixture
def task(library, template):
    """Does a task of the library and says how often the engine was started for `a` so far."""

    def work(*words: str, expect: int = 0) -> int:
        line = ["-o", str(library.root), "--resume", "--progress", "plain", *words]
        assert run_batch(template, line) == expect
        log = JobPaths(library.root / "a").log
        return len(re.findall("^start", log.read_text(), re.M)) if log.exists() else 0

    return work


def states(library: LibraryPaths) -> list[str]:
    return re.findall(r'<article class="(\w+)"', library.page.read_text())


def test_only_the_fit_asks_for_a_graphics_card(tmp_path, library, template):
    captures = make_captures(tmp_path / "shots", {"a": "", "b": ""})
    line = [str(captures / "*"), "-o", str(library.root), "--on", "openjd"]
    run_batch(template, [*line, "--split"])
    *steps, page = read_json(library.openjd / "template.json")["steps"]
    assert [step["name"] for step in steps] == ["Read", "Fit", "Finish"]
    before = [[other["dependsOn"] for other in step.get("dependencies", ())] for step in steps]
    assert [*before, page["dependencies"][0]["dependsOn"]] == [[], ["Read"], ["Fit"], "Finish"]
    amounts = [[amount["name"] for amount in s["hostRequirements"]["amounts"]] for s in steps]
    assert ["amount.worker.gpu" in names for names in amounts] == [False, True, False]
    parts = [step["script"]["actions"]["onRun"]["args"] for step in steps]
    assert [words[words.index("--stages") + 1] for words in parts] == [
        "capture-capture", "geometry-geometry", "transport-export"
    ]  # fmt: skip
    run_batch(template, line)
    steps = read_json(library.openjd / "template.json")["steps"]
    assert [step["name"] for step in steps] == ["Reconstruct", "Page"]


def test_each_task_does_its_stages_and_no_more(tmp_path, library, template, task, capsys):
    captures = make_captures(tmp_path / "shots", {"a": ""})
    run_batch(template, [str(captures / "a"), "-o", str(library.root), "--on", "openjd"])
    assert task("--task", "0", "--stages", "geometry") == 0
    assert "capture is not done" in capsys.readouterr().err
    assert task("--task", "0", "--stages", "capture") == 1
    assert task("--page") == 1
    assert states(library) == ["waiting"]
    assert task("--task", "0", "--stages", "geometry") == 2
    assert task("--task", "0", "--stages", "transport-export") == 3
    assert task("--task", "0", "--stages", "transport-export") == 3  # it is whole by then
    log = JobPaths(library.root / "a").log.read_text()
    assert re.findall("end of (.*) on (.*) ", log) == [("capture", "cpu"), ("geometry", "auto")]
    task("--page")
    assert states(library) == ["done"]


def test_what_the_first_task_refuses_is_told_once(tmp_path, library, template, task):
    captures = make_captures(tmp_path / "shots", {"a": "refuse no photographs"})
    run_batch(template, [str(captures / "a"), "-o", str(library.root), "--on", "openjd"])
    assert task("--task", "0", "--stages", "capture") == 1
    assert task("--task", "0", "--stages", "geometry") == 1
    assert task("--task", "0", "--stages", "transport-export") == 1
    task("--page")
    assert states(library) == ["failed"] and "no photographs" in library.page.read_text()


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["--split"], "--split is for farms"),
        (["--fit-queue", "gpu"], "is a partition of Slurm's"),
        (["--fit-queue", "gpu", "--on", "openjd", "--split"], "is a partition of Slurm's"),
    ],
)
def test_what_only_farms_have_is_refused_elsewhere(library, words, sentence):
    with pytest.raises(UsageError, match=sentence):
        run_batch(library.root, ["a", "-o", str(library.root), *words])


@pytest.mark.parametrize("text", ["fit", "geometry-capture", "capture-", "-export", ""])
def test_stages_that_are_none_are_refused(library, text, capsys):
    with pytest.raises(SystemExit):
        run_batch(library.root, ["-o", str(library.root), "--task", "0", f"--stages={text}"])
    assert "names no stages" in capsys.readouterr().err


def test_slurm_is_asked_for_arrays_that_wait_for_each_other(tmp_path, monkeypatch):
    """By what stands for `sbatch`: it keeps its words and counts the jobs."""
    asked, program = tmp_path / "asked", tmp_path / "sbatch"
    program.write_text('#!/bin/sh\necho "$@" >> "$ASKED"\nwc -l < "$ASKED"\n')
    program.chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path), prepend=os.pathsep)
    monkeypatch.setenv("ASKED", str(asked))
    job = library_job(LibraryPaths(tmp_path), tmp_path / "shots", [0, 1, 2, 5], 3 << 30, "gpu")
    assert submit_to_slurm(job, tmp_path / "logs") == ["1", "2", "3", "4"]
    read, fit, finish, page = asked.read_text().splitlines()
    assert all("--array 0-2,5 --mem=3072M" in words for words in (read, fit, finish))
    assert "--gres=gpu:1 --partition=gpu --dependency aftercorr:1 " in fit
    assert "--dependency aftercorr:2 " in finish and "gpu" not in read + finish
    assert "--array" not in page and "--dependency afterany:3 " in page
