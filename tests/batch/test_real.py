# SPDX-License-Identifier: Apache-2.0
"""A small share of the harnesses with the real engine: a full disk in one, and a few kills."""

from __future__ import annotations

import json
import os
import random
import subprocess
import sys
import time
from pathlib import Path

import pytest

from robir.jobs.library import LibraryPaths, read_batch
from robir.specimen import SETTINGS, write_specimen
from tests.batch.kills import KINDS, LEAST, Range

pytestmark = pytest.mark.slow


@pytest.fixture
def small_disk(tmp_path):
    """A result folder on a disk of its own, which is full at once."""
    folder = tmp_path / "library" / "b"
    folder.mkdir(parents=True)
    mounted = (
        os.geteuid() == 0
        and not subprocess.run(
            ["mount", "-t", "tmpfs", "-o", "size=200k", "tmpfs", str(folder)],
            check=False,
            capture_output=True,
        ).returncode
    )
    if not mounted:
        pytest.skip("FULL DISK NOT TESTED: it takes root and a system that lets it mount")
    yield folder
    subprocess.run(["umount", str(folder)], check=True)


def test_a_full_disk_in_one_leaves_the_others_alone(tmp_path, small_disk):
    for name in "abc":
        write_specimen(tmp_path / "shots" / name)
    settings = json.dumps([*SETTINGS, *(item for item in LEAST if "export." not in item)])
    plan = tmp_path / "plan.toml"
    plan.write_text(f"formats = ['glb']\nsettings = {settings}\n[[capture]]\npath = 'shots/*'\n")
    library = LibraryPaths(small_disk.parent)
    command = [sys.executable, "-P", "-m", "robir", "batch", str(plan), "-o", str(library.root)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    rows = {row["name"]: row for row in read_batch(library)["captures"]}
    assert {name: row["state"] for name, row in rows.items()} == {
        "a": "done", "b": "failed", "c": "done"
    }, done.stderr  # fmt: skip
    assert "disk" in rows["b"]["message"] or "No space" in rows["b"]["message"]
    assert "Traceback" not in done.stderr


@pytest.mark.blender
def test_kills_lose_nothing(tmp_path):
    shots, generator = Range(Path(tmp_path), 2), random.Random(0)
    process = shots.begin(shots.library, "--jobs", "2")
    for kind in KINDS[1:]:
        end = time.monotonic() + 60.0
        while not shots.workers() and process.poll() is None and time.monotonic() < end:
            time.sleep(0.05)
        time.sleep(generator.uniform(2.0, 8.0))
        shots.kill(process, kind, generator)
        assert not shots.listed_wrongly()
        if process.poll() is not None:
            process = shots.begin(shots.library, "--jobs", "2")
    process.wait()
    shots.begin(shots.library, "--jobs", "2").wait()
    for capture in shots.captures:
        assert shots.seen(shots.library, capture.name) == shots.expected[capture.name]
    assert not shots.finished_twice()
