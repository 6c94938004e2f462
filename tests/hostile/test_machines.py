# SPDX-License-Identifier: Apache-2.0
"""What machines and their users do to a run: suspended, its clock set back, two in one folder."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from robir.jobs import client
from robir.jobs.folder import folder_lock, holder
from robir.jobs.paths import JobPaths
from robir.pipeline.runner import reconstruct
from tests.pipeline.fakes import Silent, fake_stages, make_capture, request
from tests.pipeline.test_resume import contents

ROOT = Path(__file__).parents[2]

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="takes POSIX signals and users")


# of a run whose clock goes back by a day in its midst
BACK = """
import runpy, time
real, calls = time.time, []

def back_by_a_day():
    calls.append(0)
    return real() - (86400 if len(calls) > 20 else 0)

time.time = back_by_a_day
runpy.run_module("tests.pipeline.fakes", run_name="__main__")
assert len(calls) > 20
"""


@pytest.fixture
def whole(tmp_path) -> Path:
    """A capture, and what becomes of it where nothing happens."""
    capture = make_capture(tmp_path / "capture")
    reconstruct(request(capture, tmp_path / "whole"), Silent(), fake_stages())
    return tmp_path / "whole"


def begun(out: Path, *program: str) -> subprocess.Popen[str]:
    """The stages at work in a process; its clock may be another."""
    words = [str(out.parent / "capture"), str(out), "0.02"]
    environment = os.environ | {"PYTHONPATH": str(ROOT / "core")}
    command = [sys.executable, *(program or ("-m", "tests.pipeline.fakes")), *words]
    return subprocess.Popen(command, cwd=ROOT, env=environment, stderr=subprocess.PIPE, text=True)


def wait_for(out: Path, process: subprocess.Popen[str]) -> None:
    while process.poll() is None and holder(JobPaths(out).lock) is None:
        time.sleep(0.01)


@pytest.mark.parametrize("program", [(), ("-c", BACK)], ids=["", "clock"])
def test_a_suspended_run_is_at_work_and_goes_on(whole, program):
    out = whole.with_name("out")
    with begun(out, *program) as process:
        wait_for(out, process)
        process.send_signal(signal.SIGSTOP)
        time.sleep(0.7)
        assert client.snapshot(out).is_live
        assert process.poll() is None
        process.send_signal(signal.SIGCONT)
        assert process.wait(120) == 0
    assert client.snapshot(out).state == "done"
    assert contents(out) == contents(whole)


def test_two_in_one_folder_do_not_meet(whole):
    """Whoever comes second is told; the first one's result is what it would have been."""
    out = whole.with_name("out")
    with begun(out) as one, begun(out) as other:
        said = [process.communicate(timeout=120)[1] for process in (one, other)]
        codes = [one.returncode, other.returncode]
    assert sorted(codes) in ([0, 1], [0, 0])  # the second may also find the first one's work done
    refused = [text for text, code in zip(said, codes, strict=True) if code]
    assert all("is in use by process" in text for text in refused)
    assert contents(out) == contents(whole)


@pytest.mark.skipif(not hasattr(os, "getuid") or os.getuid() != 0, reason="takes root")
def test_another_user_sees_who_is_at_work(tmp_path):
    for folder in (tmp_path, *tmp_path.parents):
        if folder.stat().st_uid == 0 and folder.name.startswith(("pytest", "test")):
            folder.chmod(0o755)
    path = tmp_path / "lock"
    with folder_lock(path):
        child = os.fork()
        if not child:
            os.setuid(65534)
            os._exit(0 if holder(path) == os.getppid() else 1)
        assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
