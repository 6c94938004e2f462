# SPDX-License-Identifier: Apache-2.0
"""Workers that outlive their starter: followed, stopped, killed and found again, all for real."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from robir.config import RunConfig, resolve
from robir.errors import DeviceError, UsageError
from robir.jobs import client
from robir.jobs.folder import folder_lock, holder
from robir.jobs.paths import JobPaths, read_json, write_json
from robir.jobs.status import StatusWriter
from tests.pipeline.fakes import make_capture

FAKE = Path(__file__).with_name("fake_engine.py")
ENVIRONMENT = {**os.environ, "PYTHONPATH": str(FAKE.parents[2] / "core")}
AWKWARD = 'it\'s a "capture" of Gänse 鵝 $HOME'


def program(pause: object) -> list[str]:
    return [sys.executable, "-P", str(FAKE), str(pause)]


def until(root: Path, wanted: Callable[[client.Snapshot], bool], seconds: float = 120.0):
    """The first snapshot that fits."""
    end = time.monotonic() + seconds
    while not wanted(found := client.snapshot(root)):
        assert time.monotonic() < end, found
        time.sleep(0.02)
    return found


def ended(snapshot: client.Snapshot) -> bool:
    return not snapshot.is_live


def running(snapshot: client.Snapshot) -> bool:
    return snapshot.state == "running"


@pytest.fixture
def request_(tmp_path) -> client.Request:
    capture = make_capture(tmp_path / AWKWARD)
    return client.Request(capture=capture, out=tmp_path / f"{AWKWARD} result")


@pytest.fixture
def out(request_):
    yield request_.out
    client.stop(request_.out, is_forced=True)


@pytest.fixture(autouse=True)
def _no_zombies():
    yield
    while client._children:
        client._children.popitem()[1].wait(120)


def worker_of(out: Path) -> int:
    pid = holder(JobPaths(out).lock)
    assert pid
    return pid


def test_a_run_is_followed_from_start_to_end(request_, out):
    assert client.snapshot(out).state == "none"
    client.start(program(0.02), request_, os.environ)
    assert client.snapshot(out).is_live
    seen = []
    until(out, lambda now: seen.append(now) or now.state == "done")
    fractions = [now.fraction for now in seen if now.state == "running"]
    assert fractions == sorted(fractions) and fractions[-1] > fractions[0]
    assert {"geometry", "appearance"} <= {now.stage for now in seen}
    last = seen[-1]
    assert (last.fraction, last.exit_code, last.log) == (1.0, 0, ())
    assert last.metrics["mean"] == read_json(JobPaths(out).manifest("export"))["metrics"]["mean"]
    client.start(program(0.02), request_, os.environ)
    worker = client._children[out].pid
    assert "finished already" in until(out, ended).message
    end = time.monotonic() + 120.0
    while Path(f"/proc/{worker}").exists():
        assert time.monotonic() < end, "nobody asked the ended worker for its exit code"
        time.sleep(0.02)


def test_a_killed_worker_is_noticed_and_the_next_goes_on(request_, out):
    client.start(program(0.1), request_, os.environ)
    until(out, lambda now: now.stage == "transport")
    os.kill(worker_of(out), signal.SIGKILL)
    dead = until(out, ended)
    assert (dead.state, dead.exit_code) == ("died", -9)
    assert "killed in transport" in dead.message and "press Reconstruct" in dead.message
    assert any("geometry" in line for line in dead.log)
    geometry = JobPaths(out).manifest("geometry").stat().st_mtime_ns
    client.start(program(0.0), request_, os.environ)
    assert until(out, ended).state == "done"
    assert JobPaths(out).manifest("geometry").stat().st_mtime_ns == geometry


def test_a_worker_outlives_its_starter_and_is_found_by_its_folder(request_, out):
    script = (
        "import os, sys; from pathlib import Path; from robir.jobs import client\n"
        "capture, out, *program = sys.argv[1:]\n"
        "job = client.Request(capture=Path(capture), out=Path(out))\n"
        "client.start(program, job, os.environ)\n"
        "import time; time.sleep(600)"
    )
    words = [sys.executable, "-c", script, str(request_.capture), str(out), *program(0.1)]
    starter = subprocess.Popen(words, env=ENVIRONMENT, start_new_session=True)
    until(out, running)
    if hasattr(os, "getpriority"):
        assert os.getpriority(os.PRIO_PROCESS, worker_of(out)) > os.getpriority(os.PRIO_PROCESS, 0)
    os.killpg(starter.pid, signal.SIGKILL)
    starter.wait()
    time.sleep(0.2)
    assert client.snapshot(out).state == "running"
    with pytest.raises(UsageError, match="in use by process"):
        client.start(program(0.0), request_, os.environ)
    os.kill(worker_of(out), signal.SIGKILL)
    assert until(out, ended).state == "died"


def _is_alive(pid: int) -> bool:
    """Whether a process runs; one that nobody has asked for its exit code does not."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="needs /proc")
def test_a_deaf_worker_is_ended_with_its_children(request_, out):
    client.start(program("deaf"), request_, os.environ)
    until(out, lambda _: (out / "child").exists() and (out / "child").read_text())
    child = int((out / "child").read_text())
    client.request_cancel(out)
    client.stop(out)
    time.sleep(0.3)
    assert client.snapshot(out).state == "running"
    client.stop(out, is_forced=True)
    assert until(out, ended).state == "cancelled"
    end = time.monotonic() + 120.0
    while _is_alive(child):
        assert time.monotonic() < end
        time.sleep(0.05)


def test_an_engine_that_does_not_run_is_said(request_, out):
    with pytest.raises(DeviceError, match="check the engine"):
        client.start([str(out / "absent" / "python")], request_, os.environ)
    client.start([sys.executable, "-I", "-S", "-m", "robir"], request_, os.environ)
    died = until(out, ended)
    assert died.state == "died" and "No module named robir" in died.message


def test_a_number_used_again_is_no_worker(tmp_path):
    stranger = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(60)"])
    try:
        paths = JobPaths(tmp_path)
        write_json(paths.worker, {"started": time.time() - 3600.0, "pid": stranger.pid})
        StatusWriter(paths).status("running", stage="geometry", fraction=0.3, message="fitting")
        paths.lock.write_text(f"{stranger.pid}\n")
        assert client.snapshot(tmp_path).state == "died"
        client.stop(tmp_path, is_forced=True)
        time.sleep(0.1)
        assert stranger.poll() is None
    finally:
        stranger.kill()
        stranger.wait()


def test_a_look_at_the_lock_never_keeps_a_worker_out(tmp_path):
    path = tmp_path / "lock"
    looker = subprocess.Popen(
        [sys.executable, "-c",
         "import sys; from pathlib import Path; from robir.jobs.folder import holder\n"
         "while True: holder(Path(sys.argv[1]))", str(path)],
        env=ENVIRONMENT,
    )  # fmt: skip
    try:
        time.sleep(0.3)
        for _ in range(200):
            path.touch()  # as a killed worker leaves it
            with folder_lock(path):
                pass
    finally:
        looker.kill()
        looker.wait()


@pytest.fixture
def small_disk(tmp_path):
    place = tmp_path / "disk"
    place.mkdir()
    mount = shutil.which("mount")
    words = [mount or "mount", "-t", "tmpfs", "-o", "size=1536k", "none", str(place)]
    if mount is None or subprocess.run(words, capture_output=True, check=False).returncode:
        pytest.skip("a small disk can be mounted by root only")
    yield place
    subprocess.run(["umount", "-l", str(place)], check=True)


def test_a_full_disk_is_said_and_nothing_lost(request_, small_disk):
    job = client.Request(capture=request_.capture, out=small_disk / "out")
    client.start(program(0.1), job, os.environ)
    until(job.out, lambda now: now.stage == "geometry")
    filler = small_disk / "filler"
    with pytest.raises(OSError, match="No space"), filler.open("wb", buffering=0) as file:
        while True:
            file.write(bytes(4096))
    full = until(job.out, ended)
    assert full.state in ("failed", "died")
    assert "make room" in full.message
    filler.unlink()
    client.start(program(0.0), job, os.environ)
    assert until(job.out, ended).state == "done"


def test_a_box_is_a_setting_on_the_command_line(tmp_path):
    job = client.Request(capture=tmp_path, out=tmp_path / "out", box=(1, 2, 3, 4, 5, 6))
    assert job.choice_words() == ["--set", "capture.box=[1.0, 2.0, 3.0, 4.0, 5.0, 6.0]"]
    assert job.words()[-6:-4] == job.choice_words()
    job = replace(job, box=(), skips_missing=True, left_out=("r_1", 'Käthe\'s "hot" 🌭'))
    words = job.choice_words()
    assert words[0] == "--skip-missing"
    assert resolve(RunConfig(), None, words[2:]).capture.leave_out == job.left_out
    assert "--set" not in client.Request(capture=tmp_path, out=tmp_path / "out").words()
