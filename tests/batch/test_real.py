# SPDX-License-Identifier: Apache-2.0
"""A small share of the harnesses with the real engine: a full disk in one, and a few kills."""

from __future__ import annotations

import json
import os
import random
import subprocess
import sys
import time

import pytest
from hostile.tiny_run import contents

from robir.jobs.library import read_batch
from robir.specimen import SETTINGS, write_specimen
from tests.batch.fakes import ROOT, make_captures, variables
from tests.batch.kills import KINDS, Range

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
    # lazily, as the engine has said its last word but may still be going
    subprocess.run(["umount", "--lazy", str(folder)], check=True)


def test_a_full_disk_in_one_leaves_the_others_alone(tmp_path, small_disk, library, template):
    """The one is the real engine's, the others may be anybody's."""
    shots = make_captures(tmp_path / "shots", {"a": "", "b": "really", "c": "sleep 1"})
    write_specimen(shots / "b")
    plan = tmp_path / "plan.toml"
    plan.write_text(
        f"formats = ['glb']\nsettings = {json.dumps(SETTINGS)}\n[[capture]]\npath = 'shots/*'\n"
    )
    command = [sys.executable, "-m", "tests.batch.fakes", str(template), str(plan)]
    done = subprocess.run(
        [*command, "-o", str(library.root)],
        capture_output=True, text=True, check=False, cwd=ROOT, env=variables(),
    )  # fmt: skip
    rows = {row["name"]: row for row in read_batch(library)["captures"]}
    assert {name: row["state"] for name, row in rows.items()} == {
        "a": "done", "b": "failed", "c": "done"
    }, done.stderr  # fmt: skip
    assert "disk" in rows["b"]["message"] or "No space" in rows["b"]["message"]
    assert "Traceback" not in done.stderr


@pytest.mark.blender
def test_kills_lose_nothing(tmp_path, shots, at_home, library):
    """Two results of one capture, each as the library has it that nothing disturbed."""
    plan, first = tmp_path / "plan.toml", (shots / "plan.toml").read_text().partition("[[")[0]
    each = f"[[capture]]\npath = '{shots / 'sphere'}'\ntags = ['round']\nname = "
    plan.write_text(f"{first}{each}'one'\n{each}'two'\n")
    expected = contents(at_home.result("sphere").root)
    killed = Range(plan, library, dict.fromkeys(("one", "two"), expected))
    process, generator = killed.begin(), random.Random(0)
    for kind in KINDS[2:]:
        end = time.monotonic() + 60.0
        while not killed.workers() and process.poll() is None and time.monotonic() < end:
            time.sleep(0.05)
        time.sleep(generator.uniform(2.0, 8.0))
        killed.kill(process, kind, generator)
        assert not killed.listed_wrongly()
        if process.poll() is not None:
            process = killed.begin()
    process.wait()
    killed.begin().wait()
    assert not killed.differing()
    assert not killed.finished_twice()
