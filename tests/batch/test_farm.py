# SPDX-License-Identifier: Apache-2.0
"""The same library from an Open Job Description runner, and what Slurm is asked for."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest
from hostile.tiny_run import contents, scenes

from robir import cli
from robir.errors import UsageError
from robir.jobs.library import LibraryPaths
from robir.jobs.paths import read_json
from tests.batch.fakes import variables


def same(one: LibraryPaths, other: LibraryPaths) -> bool:
    """Whether two libraries are alike to the last bit, times and addresses of memory apart."""
    results = [contents(library.result("sphere").root) for library in (one, other)]
    assert results[0] == results[1]
    assert len(set(scenes([library.result("sphere").root for library in (one, other)]))) == 1
    for name in ("catalogues", "plan", "page"):
        texts = [getattr(library, name).read_text() for library in (one, other)]
        if name == "page":
            texts = [seconds_out(text) for text in texts]
        if name == "plan":
            texts = [str(json.loads(text)["entries"]) for text in texts]
        assert texts[0] == texts[1], name
    return True


def seconds_out(page: str) -> str:
    return re.sub(r'data-seconds="[^"]*"|\d+ CPU-s', "", page)


def openjd() -> str:
    beside = Path(sys.executable).with_name("openjd")
    found = str(beside) if beside.exists() else shutil.which("openjd")
    if found is None:
        pytest.skip("RENDER FARMS NOT TESTED: openjd-cli is not installed (pip install openjd-cli)")
    return found


@pytest.mark.slow
@pytest.mark.blender
def test_open_job_description_makes_the_same_library(shots, at_home, library, tmp_path, robir):
    """From parts of the stages as tasks of their own, on a farm that sees both places elsewhere."""
    program, words = openjd(), ("--on", "openjd", "--split")
    folder = Path(robir("batch", shots / "plan.toml", "-o", library.root, *words, expect=0).strip())
    assert str(tmp_path) not in "".join(file.read_text() for file in folder.iterdir())
    values = read_json(folder / "parameter_values.json")["parameterValues"]
    places = {value["name"]: str((folder / value["value"]).resolve()) for value in values}
    far = tmp_path / "far"
    far.mkdir()
    (far / "library").symlink_to(places["Library"])
    rule = {"source_path_format": "POSIX", "source_path": "/studio/lib"}
    rules = [rule | {"destination_path": str(far / "library")}]
    said = subprocess.run(
        [
            *(program, "run", str(folder / "template.json"), "--step", "Page"),
            *("--run-dependencies", "-p", "Library=/studio/lib", "-p", f"Python={sys.executable}"),
            *("-p", f"Captures={places['Captures']}"),
            "--path-mapping-rules",
            json.dumps({"version": "pathmapping-1.0", "path_mapping_rules": rules}),
        ],
        capture_output=True, text=True, env=variables(), check=False,
    )  # fmt: skip
    assert said.returncode == 0, said.stdout[-3000:] + said.stderr[-2000:]
    assert same(at_home, library)


def test_a_task_that_the_plan_lacks_is_refused(shots, library, robir):
    paths = library
    robir("batch", shots / "plan.toml", "-o", paths.root, "--on", "openjd", expect=0)
    robir("batch", "--resume", "-o", paths.root, "--task", 2, expect=UsageError.exit_code)
    # a capture's own fault is no reason for a farm to try again; the page tells of it
    robir("batch", "--resume", "-o", paths.root, "--task", 1, expect=0)
    robir("batch", "-o", paths.root, "--page", expect=0)
    page = paths.page.read_text()
    assert "holds no capture" in page
    assert page.index('data-name="empty"') < page.index('data-name="sphere"')


def test_time_is_linear_in_the_number_of_captures(tmp_path):
    taken = []
    for count in (1, 100, 1000):  # the first one imports
        folder = tmp_path / str(count)
        names = [f"c{number}" for number in range(count)]
        for name in names:
            (folder / name).mkdir(parents=True)
        plan = folder / "plan.toml"
        plan.write_text("".join(f"[[capture]]\npath = '{name}'\n" for name in names))
        start = time.process_time()
        words = ["batch", str(plan), "-o", str(folder / "library"), "--on", "openjd"]
        assert cli.main(words) == 0
        taken.append(time.process_time() - start)
    assert taken[2] < 25 * taken[1]  # ten times as many
