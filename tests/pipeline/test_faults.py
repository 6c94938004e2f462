# SPDX-License-Identifier: Apache-2.0
"""Everything that can end a run early, and what the user is told."""

from __future__ import annotations

import errno
import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from robir.errors import (
    CancelledError,
    DeviceError,
    QualityError,
    StorageError,
    UsageError,
)
from robir.jobs.paths import JobPaths, read_json
from robir.jobs.status import read_status
from robir.pipeline.runner import reconstruct
from tests.pipeline.fakes import Silent, fake_stages, make_capture, request


def run_with_mischief(tmp_path: Path, mischief) -> JobPaths:
    capture, out = make_capture(tmp_path / "capture"), tmp_path / "out"
    stages = fake_stages()
    stages["geometry"].mischief = mischief
    reconstruct(request(capture, out), Silent(), stages)
    return JobPaths(out)


def raising(error):
    def mischief(_context):
        raise error

    return mischief


@pytest.mark.parametrize(
    ("error", "expected", "words"),
    [
        (OSError(errno.ENOSPC, "No space left on device", "x.npz"), StorageError, "make room"),
        (MemoryError(), DeviceError, "out of memory in geometry: lower geometry"),
        (RuntimeError("CUDA out of memory. Tried to allocate"), DeviceError, "geometry"),
        (
            RuntimeError("[enforce fail] DefaultCPUAllocator: can't allocate memory"),
            DeviceError,
            "geom",
        ),
        (KeyboardInterrupt(), CancelledError, "--resume"),
    ],
)
def test_faults_are_told_in_words(tmp_path, error, expected, words):
    with pytest.raises(expected, match=words):
        run_with_mischief(tmp_path, raising(error))
    status = read_status(JobPaths(tmp_path / "out").status)
    assert status.exit_code == expected.exit_code
    assert status.stage == "geometry"
    reconstruct(
        request(tmp_path / "capture", tmp_path / "out", is_resume=True), Silent(), fake_stages()
    )


def test_a_nan_stops_the_stage_that_made_it(tmp_path):
    def mischief(context):
        np.savez(context.paths.stage("geometry") / "mesh.npz", vertices=np.array([0.0, np.nan]))

    with pytest.raises(QualityError, match=r"geometry.*mesh\.npz:vertices"):
        run_with_mischief(tmp_path, mischief)
    assert not JobPaths(tmp_path / "out").manifest("geometry").exists()


def test_the_cancel_file_stops_a_run_and_is_gone_at_the_next(tmp_path):
    with pytest.raises(CancelledError, match="--resume"):
        run_with_mischief(tmp_path, lambda context: context.paths.cancel.touch())
    paths = JobPaths(tmp_path / "out")
    assert read_status(paths.status).state == "cancelled"
    reconstruct(request(tmp_path / "capture", paths.root, is_resume=True), Silent(), fake_stages())
    assert read_json(paths.run)["state"] == "done"


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_stops_a_run(tmp_path, number):
    with pytest.raises(CancelledError, match=number.name):
        run_with_mischief(tmp_path, lambda _context: os.kill(os.getpid(), number))
    assert read_status(JobPaths(tmp_path / "out").status).exit_code == 130


def test_warnings_are_kept_and_belong_to_their_stage(tmp_path):
    paths = run_with_mischief(tmp_path, lambda context: context.reporter.warn("few views"))
    assert read_json(paths.run)["warnings"] == [{"stage": "geometry", "message": "few views"}]
    assert "few views" in paths.log.read_text()


def test_a_folder_in_use_is_refused_and_a_dead_holder_is_not(tmp_path):
    out = tmp_path / "out"
    capture = make_capture(tmp_path / "capture")
    out.mkdir()
    program = (
        "import sys, time; from pathlib import Path; from robir.jobs.folder import folder_lock\n"
        f"with folder_lock(Path({str(out / 'lock')!r})):\n"
        "    print('held', flush=True); time.sleep(60)"
    )
    command = [sys.executable, "-c", program]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=python_path()) as holder:
        assert holder.stdout is not None
        assert holder.stdout.readline() == "held\n"
        with pytest.raises(UsageError, match=f"in use by process {holder.pid}"):
            reconstruct(request(capture, out), Silent(), fake_stages())
        holder.kill()
    assert (out / "lock").exists()
    reconstruct(request(capture, out), Silent(), fake_stages())
    assert not (out / "lock").exists()


def python_path() -> dict[str, str]:
    return os.environ | {"PYTHONPATH": str(Path(__file__).parents[2] / "core")}


def test_an_output_that_cannot_be_written_is_refused(tmp_path):
    capture, out = make_capture(tmp_path / "capture"), tmp_path / "out"
    (out / "lock").mkdir(parents=True)
    with pytest.raises(
        StorageError, match=r"out/lock cannot be read or written.*then continue with"
    ):
        reconstruct(request(capture, out), Silent(), fake_stages())


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EROFS, errno.EIO])
def test_a_library_that_met_a_failing_disk_is_understood(tmp_path, number):
    """OpenEXR, for one, raises an error of its own that only quotes the system's words."""
    said = f'Failed to write pixel data to image file "x.exr". {os.strerror(number)}.'
    with pytest.raises(StorageError, match=f"{os.strerror(number)}; make room"):
        run_with_mischief(tmp_path, raising(RuntimeError(said)))


def test_a_disk_that_went_away_is_told_where_no_file_is_named(tmp_path):
    with pytest.raises(StorageError, match="geometry: Stale file handle"):
        run_with_mischief(tmp_path, raising(OSError(errno.ESTALE, os.strerror(errno.ESTALE))))
