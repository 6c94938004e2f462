# SPDX-License-Identifier: Apache-2.0
"""Batches on this machine: bounds, retries, kills, drops and what a second start does."""

from __future__ import annotations

import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from robir.errors import UsageError
from robir.jobs.client import snapshot
from robir.jobs.folder import holder
from robir.jobs.library import (
    LibraryPaths,
    read_batch,
)
from robir.jobs.paths import JobPaths
from tests.batch.fakes import ROOT, make_captures, run_batch, variables


def log(library: LibraryPaths, name: str) -> list[str]:
    """What the engine noted: "start" and "end" with their times."""
    return JobPaths(library.root / name).log.read_text().splitlines()


def starts(library: LibraryPaths, name: str) -> int:
    return sum(line.startswith("start") for line in log(library, name))


def together(library: LibraryPaths, names: list[str]) -> int:
    """The most that ran at one time."""
    lines = [line for name in names for line in log(library, name)]
    moments = sorted((float(line.split()[1]), line[0]) for line in lines)
    most = now = 0
    for _, kind in moments:
        now += 1 if kind == "s" else -1
        most = max(most, now)
    return most


def states(library: LibraryPaths) -> dict[str, str]:
    return {row["name"]: row["state"] for row in read_batch(library)["captures"]}


def words(library: LibraryPaths, *more: object) -> list[str]:
    return ["-o", str(library.root), "--progress", "plain", *map(str, more)]


def program(template: Path) -> list[str]:
    return [sys.executable, "-m", "tests.batch.fakes", str(template)]


def begun(library: LibraryPaths, template: Path, *more: object) -> subprocess.Popen[bytes]:
    """A batch in a process of its own, which may be killed."""
    return subprocess.Popen(
        [*program(template), *words(library, *more)],
        cwd=ROOT,
        env=variables(),
        stderr=subprocess.DEVNULL,
    )


def until(condition, seconds: float = 120.0):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.02)


def test_each_failure_is_isolated_and_told_on_the_page(tmp_path, library, template, capsys):
    acts = {"whole": "", "bad": "refuse no <photographs>", "odd": "break it is odd", "weak": "die"}
    captures = make_captures(tmp_path / "shots", acts)
    code = run_batch(template, words(library, captures / "*", "--jobs", 2))
    assert code == 3
    assert states(library) == {"bad": "failed", "odd": "failed", "weak": "done", "whole": "done"}
    # once more, but not what the user has to mend
    assert {name: starts(library, name) for name in acts} == {
        "whole": 1, "bad": 1, "odd": 2, "weak": 2
    }  # fmt: skip
    page = library.page.read_text()
    names = re.findall(r'<article class="(\w+)".*?data-name="(\w+)"', page)
    assert names == [("failed", "bad"), ("failed", "odd"), ("done", "weak"), ("done", "whole")]
    assert "no &lt;photographs&gt;" in page
    said = capsys.readouterr()
    assert "bad: no <photographs>" in said.err
    assert said.out.strip() == str(library.page)


def test_a_second_start_does_only_what_is_missing(tmp_path, library, template):
    captures = make_captures(tmp_path / "shots", {"a": "", "b": "refuse for now", "c": ""})
    assert run_batch(template, words(library, captures / "*")) == 3
    (captures / "b" / "act").write_text("")
    (captures / "c" / "transforms.json").write_text("{ }")  # another capture by its contents
    run_batch(template, words(library, "--resume"))
    assert [starts(library, name) for name in "abc"] == [1, 2, 2]


def test_memory_bounds_what_runs_at_a_time(tmp_path, library, template):
    """8 GB for captures of 3 each are two at a time; one that needs 12 runs alone."""
    acts = dict.fromkeys("abcd", "sleep 0.5")
    make_captures(tmp_path / "shots", acts)
    plan = tmp_path / "plan.toml"
    sizes = dict.fromkeys("abcd", "3G")
    plan.write_text(
        "".join(f"[[capture]]\npath='shots/{n}'\nmemory='{size}'\n" for n, size in sizes.items())
    )
    words_ = words(library, plan, "--jobs", 4, "--memory", "8G")
    assert run_batch(template, words_) == 0
    assert together(library, list("abcd")) == 2
    other = LibraryPaths(tmp_path / "other")
    plan.write_text(plan.read_text().replace("'shots/b'\nmemory='3G'", "'shots/b'\nmemory='12G'"))
    assert run_batch(template, words(other, plan, "--jobs", 4, "--memory", "8G")) == 0
    assert together(other, ["a", "b"]) == together(other, ["b", "c"]) == 1


def test_two_batches_on_one_library_do_not_meet(tmp_path, library, template):
    go = tmp_path / "go"
    captures = make_captures(tmp_path / "shots", {"a": f"wait {go}"})
    first = begun(library, template, captures / "a")
    until(lambda: snapshot(library.root / "a").state == "running")
    with pytest.raises(UsageError, match=f"is in use by process {first.pid}"):
        run_batch(template, words(library, "--resume"))
    go.touch()
    assert first.wait(120) == 0
    assert starts(library, "a") == 1


def test_what_a_killed_batch_leaves_at_work_is_found(tmp_path, library, template):
    go = tmp_path / "go"
    captures = make_captures(tmp_path / "shots", {"a": f"wait {go}", "b": ""})
    first = begun(library, template, captures / "*", "--jobs", 1)
    until(lambda: snapshot(library.root / "a").state == "running")
    first.kill()
    first.wait()
    worker = holder(JobPaths(library.root / "a").lock)
    library.state.unlink(missing_ok=True)
    second = begun(library, template, "--resume", "--jobs", 1)
    until(lambda: library.state.exists() and states(library).get("a") == "running")
    assert holder(JobPaths(library.root / "a").lock) == worker  # the very same
    assert states(library)["b"] == "waiting"  # and its core is counted
    go.touch()
    assert second.wait(120) == 0
    assert (starts(library, "a"), starts(library, "b")) == (1, 1)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_batch_that_is_told_to_stop_ends_its_processes(tmp_path, library, template, number):
    captures = make_captures(tmp_path / "shots", {"a": "sleep 60", "b": ""})
    running = begun(library, template, captures / "*", "--jobs", 1)
    until(lambda: snapshot(library.root / "a").state == "running")
    running.send_signal(number)
    assert running.wait(120) != 0
    assert holder(JobPaths(library.root / "a").lock) is None
    assert not (library.root / "b").exists()


def test_a_capture_may_be_dropped_while_it_waits(tmp_path, library, template):
    go = tmp_path / "go"
    captures = make_captures(tmp_path / "shots", {"a": f"wait {go}", "b": "", "c": ""})
    running = begun(library, template, captures / "*", "--jobs", 1)
    until(lambda: snapshot(library.root / "a").state == "running")
    library.dropped.mkdir(parents=True)
    (library.dropped / "b").touch()
    until(lambda: library.state.exists() and states(library)["b"] == "dropped")
    go.touch()
    assert running.wait(120) == 0
    assert states(library) == {"a": "done", "b": "dropped", "c": "done"}


def test_a_library_offers_the_formats_that_are_asked_for(tmp_path, library, template):
    captures = make_captures(tmp_path / "shots", {"a": ""})
    JobPaths(template).asset.write_bytes(b"")
    assert run_batch(template, words(library, captures / "a", "--format", "glb")) == 0
    offered = re.compile(r'<a href="(a/export/[^"]+)">(\w+)</a>')
    assert offered.findall(library.page.read_text()) == [("a/export/asset.glb", "glb")]
    assert not library.facts("a").exists() and not library.catalogues.exists()
    # what is there already is not made again, what is not is
    assert run_batch(template, words(library, "--resume", "--format", "blend,glb")) == 0
    assert starts(library, "a") == 1
    assert [kind for _, kind in offered.findall(library.page.read_text())] == ["glb", "blend"]
    assert "shots" in library.catalogues.read_text()
    assert run_batch(template, words(library, "--resume", "--format", "usd")) == 0
    assert starts(library, "a") == 2
    with pytest.raises(SystemExit):
        run_batch(template, words(library, "--resume", "--format", "fbx"))


def test_without_a_plan_there_is_nothing_to_go_on_with(library):
    with pytest.raises(UsageError, match="holds no batch"):
        run_batch(Path(), words(library, "--resume"))
    with pytest.raises(UsageError, match="go on with --resume"):
        run_batch(Path(), words(library))
