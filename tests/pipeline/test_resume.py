# SPDX-License-Identifier: Apache-2.0
"""The resume table, row by row, and a process killed anywhere."""

from __future__ import annotations

import hashlib
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest

from robir.config import RunConfig
from robir.errors import CaptureError, UsageError
from robir.jobs.paths import STAGES, JobPaths, read_json
from robir.jobs.status import read_status
from robir.pipeline.runner import reconstruct
from tests.pipeline.fakes import Silent, fake_stages, make_capture, request


def contents(out: Path) -> dict[str, str]:
    """Hashes of what a run made, without clocks and logs."""
    return {
        path.relative_to(out).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
        for folder in (out / "stages", out / "export", out / "report")
        for path in sorted(folder.rglob("*"))
        if path.is_file() and path.name != "stage.json"
    }


def calls(stages) -> dict[str, int]:
    return {name: stage.calls for name, stage in stages.items()}


def test_a_finished_folder_is_left_alone(tmp_path):
    capture, out = make_capture(tmp_path / "capture"), tmp_path / "out"
    stages = fake_stages()
    reconstruct(request(capture, out), Silent(), stages)
    before = contents(out)
    display = Silent()
    reconstruct(request(capture, out), display, stages)
    assert calls(stages) == dict.fromkeys(STAGES, 1)
    assert contents(out) == before
    assert "finished already" in display.events[-1]["message"]
    assert read_status(JobPaths(out).status).state == "done"


def test_what_a_killed_process_had_half_written_goes(tmp_path):
    """Also where nothing is left to do, and where only the asset was in the making."""
    capture, out = make_capture(tmp_path / "capture"), tmp_path / "out"
    reconstruct(request(capture, out), Silent(), fake_stages())
    paths, before = JobPaths(out), {path for path in out.rglob("*") if path.is_file()}
    paths.export.mkdir(exist_ok=True)
    # as `replacing` and the headless Blender name them; the last while Blender still writes
    shown = (paths.preview, paths.growing, paths.mesh_fit)
    made = (paths.usd, paths.library_asset, paths.library_facts)
    for file in (paths.status, paths.run, *shown, *made):
        file.with_name(f".{file.stem}-1{file.suffix}").write_text("half")
    paths.export.joinpath(".asset-1.blend@").write_text("half")
    reconstruct(request(capture, out), Silent(), fake_stages())
    assert {path for path in out.rglob("*") if path.is_file()} == before


def test_resume_skips_what_is_done_and_equals_an_unbroken_run(tmp_path):
    capture = make_capture(tmp_path / "capture")
    reconstruct(request(capture, tmp_path / "whole"), Silent(), fake_stages())
    stages = fake_stages()

    def fail(_context):
        raise CaptureError("no")

    stages["appearance"].mischief = fail
    out = tmp_path / "out"
    with pytest.raises(CaptureError):
        reconstruct(request(capture, out), Silent(), stages)
    assert read_status(JobPaths(out).status).state == "failed"
    again = fake_stages()
    reconstruct(request(capture, out, is_resume=True), Silent(), again)
    assert calls(again) == {
        "capture": 0,
        "geometry": 0,
        "transport": 0,
        "appearance": 1,
        "export": 1,
    }
    assert contents(out) == contents(tmp_path / "whole")


@pytest.mark.parametrize("cuts", [("capture", "geometry"), ("transport",), STAGES[:-1]])
def test_parts_of_the_stages_one_after_another_equal_one_run(tmp_path, cuts):
    capture, out = make_capture(tmp_path / "capture"), tmp_path / "out"
    reconstruct(request(capture, tmp_path / "whole"), Silent(), fake_stages())
    for until in cuts:
        stages = fake_stages()
        reconstruct(request(capture, out, is_resume=True, until=until), Silent(), stages)
        reconstruct(request(capture, out, is_resume=True, until=until), Silent(), stages)
        assert max(calls(stages).values()) == 1
        last = STAGES.index(until)
        assert all(JobPaths(out).manifest(stage).exists() for stage in STAGES[: last + 1])
        assert not JobPaths(out).stage(STAGES[last + 1]).exists()
        status, run = read_status(JobPaths(out).status), read_json(JobPaths(out).run)
        assert (status.state, status.exit_code, run["state"]) == ("cancelled", 0, "running")
        assert status.fraction < 1.0 and f"{until} is done" in status.message
    stages = fake_stages()
    reconstruct(request(capture, out, is_resume=True), Silent(), stages)
    assert sum(calls(stages).values()) == len(STAGES) - 1 - STAGES.index(cuts[-1])
    assert contents(out) == contents(tmp_path / "whole")
    assert read_json(JobPaths(out).run)["state"] == "done"


def test_a_changed_setting_makes_its_stage_and_the_later_ones_stale(tmp_path):
    capture, out = make_capture(tmp_path / "capture"), tmp_path / "out"
    reconstruct(request(capture, out), Silent(), fake_stages())
    old = read_json(JobPaths(out).manifest("transport"))["fingerprint"]
    config = RunConfig()
    config = replace(config, transport=replace(config.transport, num_directions=128))
    with pytest.raises(UsageError, match=r"transport\.num_directions: .* -> 128"):
        reconstruct(request(capture, out, config=config), Silent(), fake_stages())
    stages = fake_stages()
    reconstruct(request(capture, out, is_resume=True, config=config), Silent(), stages)
    assert [stages[name].calls for name in STAGES] == [0, 0, 1, 1, 1]
    aside = JobPaths(out).stale / f"transport-{old[:8]}" / "stages" / "transport"
    assert (aside / "0.npz").exists()
    assert list(JobPaths(out).stale.glob("export-*/export/light.json"))


def test_a_damaged_output_is_made_again(tmp_path):
    capture, out = make_capture(tmp_path / "capture"), tmp_path / "out"
    reconstruct(request(capture, out), Silent(), fake_stages())
    before = contents(out)
    (out / "stages" / "geometry" / "2.npz").write_bytes(b"rotten")
    stages = fake_stages()
    reconstruct(request(capture, out, is_resume=True), Silent(), stages)
    assert [stages[name].calls for name in STAGES] == [0, 1, 0, 0, 0]
    after = {name: h for name, h in contents(out).items() if ".stale" not in name}
    assert after == before


def test_an_edited_product_is_the_users_own(tmp_path):
    capture, out = make_capture(tmp_path / "capture"), tmp_path / "out"
    reconstruct(request(capture, out), Silent(), fake_stages())
    JobPaths(out).light.write_text("[9]")
    stages = fake_stages()
    reconstruct(request(capture, out), Silent(), stages)
    assert JobPaths(out).light.read_text() == "[9]"
    JobPaths(out).light.unlink()
    reconstruct(request(capture, out, is_resume=True), Silent(), stages)
    assert stages["export"].calls == 1


def test_another_capture_is_refused_by_both_names(tmp_path):
    first, second = make_capture(tmp_path / "first"), make_capture(tmp_path / "second", "[]")
    out = tmp_path / "out"
    reconstruct(request(first, out), Silent(), fake_stages())
    before = contents(out)
    for is_resume in (False, True):
        with pytest.raises(UsageError, match=r"first.*second"):
            reconstruct(request(second, out, is_resume=is_resume), Silent(), fake_stages())
    assert contents(out) == before


def test_a_folder_of_other_things_is_refused(tmp_path):
    capture, out = make_capture(tmp_path / "capture"), tmp_path / "out"
    out.mkdir()
    (out / "thesis.doc").write_text("precious")
    with pytest.raises(UsageError, match=r"thesis\.doc"):
        reconstruct(request(capture, out), Silent(), fake_stages())
    assert [path.name for path in out.iterdir()] == ["thesis.doc"]


def run_and_kill(capture: Path, out: Path, after: float) -> bool:
    """Start the fakes as a process and kill it after so many seconds of work.

    Returns:
        Whether it was still at work.
    """
    command = [sys.executable, "-m", "tests.pipeline.fakes", str(capture), str(out), "0.02"]
    process = subprocess.Popen(command, cwd=Path(__file__).parents[2], env=os.environ)
    while process.poll() is None and not JobPaths(out).run.exists():
        time.sleep(0.01)
    time.sleep(after)
    is_at_work = process.poll() is None
    process.send_signal(signal.SIGKILL)
    process.wait()
    return is_at_work


@pytest.mark.slow
def test_kill_at_any_moment_then_resume_equals_an_unbroken_run(tmp_path):
    capture = make_capture(tmp_path / "capture")
    reconstruct(request(capture, tmp_path / "whole"), Silent(), fake_stages())
    killed = 0
    for index in range(6):
        out = tmp_path / f"killed_{index}"
        killed += run_and_kill(capture, out, after=0.08 * index)
        stages = fake_stages()
        reconstruct(request(capture, out, is_resume=True), Silent(), stages)
        assert contents(out) == contents(tmp_path / "whole")
        assert not [path for path in out.rglob(".*") if path.is_file()]
    assert killed >= 4


def test_a_mesh_belongs_to_the_folder_it_went_into(tmp_path):
    """Its contents make the surface and what follows stale; another is refused, and so is none."""
    capture, out = make_capture(tmp_path / "capture"), tmp_path / "out"
    mesh = tmp_path / "scan.ply"
    mesh.write_bytes(b"a mesh that the fakes do not read")
    stages = fake_stages()
    reconstruct(request(capture, out, mesh=mesh), Silent(), stages)
    reconstruct(request(capture, out, mesh=mesh), Silent(), stages)
    assert calls(stages) == dict.fromkeys(STAGES, 1)
    facts = read_json(JobPaths(out).run)["capture"]
    assert facts["mesh"]["name"] == mesh.name
    assert str(tmp_path) not in JobPaths(out).run.read_text()
    for other in (None, mesh):
        mesh.write_bytes(b"another")
        with pytest.raises(UsageError, match=r"scan\.ply"):
            reconstruct(request(capture, out, mesh=other, is_resume=True), Silent(), stages)
    assert calls(stages) == dict.fromkeys(STAGES, 1)


@pytest.mark.parametrize("change", ["revision", "seed", "photograph"])
def test_whatever_a_result_depends_on_makes_it_stale(tmp_path, change):
    capture, out = make_capture(tmp_path / "capture"), tmp_path / "out"
    reconstruct(request(capture, out), Silent(), fake_stages())
    stages, config = fake_stages(), RunConfig()
    if change == "revision":
        stages["capture"].REVISION = 2
    elif change == "seed":
        config = replace(config, seed=1)
    else:
        (capture / "r_0.png").write_bytes(b"another photograph")
    with pytest.raises(UsageError, match="--resume"):
        reconstruct(request(capture, out, config=config), Silent(), stages)
    reconstruct(request(capture, out, config=config, is_resume=True), Silent(), stages)
    assert calls(stages) == dict.fromkeys(STAGES, 1)
