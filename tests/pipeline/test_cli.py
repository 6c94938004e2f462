# SPDX-License-Identifier: Apache-2.0
"""The command line: what it prints where, and what it exits with."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from robir import cli
from robir.config import RunConfig
from robir.errors import CaptureError, DeviceError, QualityError
from robir.export import blender
from robir.jobs.paths import JobPaths, read_json
from robir.jobs.status import read_status
from robir.pipeline import folder, runner
from robir.pipeline.faults import translated
from tests.pipeline.fakes import fake_stages, make_capture


@pytest.fixture
def stages(monkeypatch):
    made = fake_stages()
    monkeypatch.setattr(runner, "load_stages", lambda: made)
    return made


@pytest.fixture
def capture(tmp_path) -> Path:
    return make_capture(tmp_path / "capture")


def reconstruct(capture, out, *words) -> int:
    return cli.main(["reconstruct", str(capture), "-o", str(out), "--device", "cpu", *words])


def test_the_result_path_stands_alone_on_standard_output(stages, capture, tmp_path, capsys):
    assert reconstruct(capture, tmp_path / "out") == 0
    printed = capsys.readouterr()
    assert printed.out == f"{tmp_path / 'out'}\n"
    assert "is finished" in printed.err
    assert reconstruct(capture, tmp_path / "out") == 0
    assert "finished already" in capsys.readouterr().err


def test_progress_as_json_lines_to_the_last(stages, capture, tmp_path, capsys):
    def fail(_context):
        raise QualityError("shadows everywhere")

    stages["appearance"].mischief = fail
    assert reconstruct(capture, tmp_path / "out", "--progress", "json") == 5
    lines = [json.loads(line) for line in capsys.readouterr().err.splitlines()]
    assert lines[0]["kind"] == "started"
    assert {"total", "seconds_left", "stage", "message"} <= lines[1].keys()
    assert lines[-1] == {"kind": "failed", "message": "shadows everywhere", "exit_code": 5}


@pytest.mark.parametrize("words", [[], ["--progress", "json"]])
def test_a_result_that_failed_its_own_check_is_whole_and_exits_with_5(
    stages, capture, tmp_path, capsys, words
):
    stages["export"].metrics = {"is_trusted": False}
    out, paths = tmp_path / "out", JobPaths(tmp_path / "out")
    for _ in range(3):  # a second start, and a resumed one, say the same
        assert reconstruct(capture, out, *words) == 5
        printed = capsys.readouterr()
        assert printed.out == f"{out}\n"
        assert "failed its own quality check" in printed.err.splitlines()[-1]
        assert "quality check passed" not in printed.err
        status = read_status(paths.status)
        assert (status.state, status.exit_code, status.fraction) == ("done", 5, 1.0)
        assert "failed its own quality check" in status.message
        run = read_json(paths.run)
        assert (run["state"], run["exit_code"]) == ("done", 5)
        words = [*words, "--resume"]
    assert stages["export"].calls == 1
    assert paths.report.exists()


@pytest.mark.parametrize(
    ("error", "code"),
    [
        (CaptureError("a"), 3),
        (DeviceError("b"), 4),
        (QualityError("c"), 5),
        (KeyboardInterrupt(), 130),
    ],
)
def test_exit_codes(stages, capture, tmp_path, error, code):
    def fail(_context):
        raise error

    stages["geometry"].mischief = fail
    assert reconstruct(capture, tmp_path / "out") == code
    assert reconstruct(capture, tmp_path / "out") == 2


def test_a_bug_is_one_sentence_and_a_traceback_in_the_log(stages, capture, tmp_path, capsys):
    def fail(_context):
        raise ZeroDivisionError("division by zero")

    stages["geometry"].mischief = fail
    assert reconstruct(capture, tmp_path / "out") == 1
    last = capsys.readouterr().err.splitlines()[-1]
    assert last.startswith(
        "robir: internal error, ZeroDivisionError: division by zero; please report"
    )
    log = JobPaths(tmp_path / "out").log.read_text()
    assert "Traceback" in log
    assert "fakes.py" in log


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--set", "geometry.rayz=3"], "did you mean 'rays'"),
        (["--set", "geometry.rays=many"], "must be a whole number"),
        (["--set", "nonsense"], "section.key=value"),
        (["--set", "appearance.sun=[1e-320,0,0]"], "must be a finite number"),
        (["--seed", "-1"], "seed is -1"),
        (["--config", "absent.toml"], "cannot read the settings"),
    ],
)
def test_wrong_settings_start_nothing(stages, capture, tmp_path, capsys, words, message):
    assert reconstruct(capture, tmp_path / "out", *words) == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_settings_come_from_defaults_then_file_then_words(stages, capture, tmp_path):
    changes = tmp_path / "changes.toml"
    changes.write_text("seed = 4\n[geometry]\nrays = 1000\nhull_cells = 60\n")
    words = ["--config", str(changes), "--set", "geometry.rays=900"]
    assert reconstruct(capture, tmp_path / "out", *words) == 0
    config = folder.read_config(JobPaths(tmp_path / "out"))
    assert (config.seed, config.geometry.rays, config.geometry.hull_cells) == (4, 900, 60)
    assert config.geometry.face_budget == RunConfig().geometry.face_budget


def test_resume_keeps_the_settings_of_the_folder(stages, capture, tmp_path, capsys):
    """Not its masks: whoever made the folder could have any file read."""
    masks = tmp_path / "masks"
    masks.mkdir()
    out = tmp_path / "out"
    given, words = ["--seed", "7"], ["--masks", str(masks)]
    assert reconstruct(capture, out, *given, *words) == 0
    assert reconstruct(capture, out, "--resume") == 2
    assert "name the same with --masks" in capsys.readouterr().err
    assert reconstruct(capture, out, "--resume", *words) == 0
    assert stages["capture"].calls == 1
    more = ["--set", "export.render_views=2"]
    assert reconstruct(capture, out, "--resume", *words, *more) == 0
    assert (stages["appearance"].calls, stages["export"].calls) == (1, 2)
    assert folder.read_config(JobPaths(out)).seed == 7


def test_a_run_goes_on_with_the_defaults_instead(stages, capture, tmp_path, capsys):
    """Such as where another version left settings that are not known."""
    out, config = tmp_path / "out", JobPaths(tmp_path / "out").config
    assert reconstruct(capture, out, "--set", "export.render_views=2") == 0
    assert reconstruct(capture, out, "--resume", "--defaults") == 0
    assert (stages["appearance"].calls, stages["export"].calls) == (1, 2)
    assert folder.read_config(JobPaths(out)) == RunConfig()
    run = read_json(JobPaths(out).run)
    JobPaths(out).run.write_text(json.dumps(run | {"preset": "draft"}))  # as runs had it before
    config.write_text(config.read_text().replace("render_views", "render_sights"))
    assert reconstruct(capture, out, "--resume") == 2
    assert "add --defaults" in capsys.readouterr().err
    assert reconstruct(capture, out, "--resume", "--defaults") == 0


def test_a_resumed_run_is_given_its_mesh_again(stages, capture, tmp_path, capsys):
    (tmp_path / "scan.obj").write_text("read by no fake")
    mesh = ["--mesh", str(tmp_path / "scan.obj")]
    assert reconstruct(capture, tmp_path / "out", *mesh) == 0
    assert reconstruct(capture, tmp_path / "out", "--resume") == 2
    assert "name the same with --mesh" in capsys.readouterr().err
    assert reconstruct(capture, tmp_path / "out", "--resume", *mesh) == 0
    assert all(stage.calls == 1 for stage in stages.values())
    assert reconstruct(capture, tmp_path / "out", "--resume", *mesh, "--fit-mesh") == 0
    assert (stages["capture"].calls, stages["geometry"].calls) == (1, 2)
    assert reconstruct(capture, tmp_path / "other", "--fit-mesh") == 2
    assert "--mesh FILE" in capsys.readouterr().err
    assert reconstruct(capture, tmp_path / "other", "--mesh", str(tmp_path / "gone.glb")) == 3
    assert "gone.glb does not exist" in capsys.readouterr().err


def test_check_of_a_bad_capture_exits_with_3(tmp_path, capsys):
    (tmp_path / "notes.txt").write_text("no photographs here")
    assert cli.main(["check", str(tmp_path)]) == 3
    assert capsys.readouterr().out.startswith("error: ")
    assert cli.main(["check", str(tmp_path), "--json"]) == 3
    assert json.loads(capsys.readouterr().out)["accepted"] is False


@pytest.mark.parametrize("word", ["x" * 5000, "x" * 300, "a\0b", "\ud800"])
@pytest.mark.parametrize("command", [["check"], ["reconstruct", "here", "-o"], ["evaluate"]])
def test_paths_that_are_none(word, command, capsys):
    with pytest.raises(SystemExit) as ending:
        cli.main([*command, word])
    assert ending.value.code == 2
    assert "path" in capsys.readouterr().err


def test_a_broken_installation_is_no_full_disk(monkeypatch, capture, tmp_path, capsys):
    """Before the folder of the result is made there is no disk of it to ask."""

    def broken():
        raise ImportError("skimage.transform")

    monkeypatch.setattr(runner, "load_stages", broken)
    assert reconstruct(capture, tmp_path / "not" / "there") == 4
    assert "installation is damaged" in capsys.readouterr().err
    bug = ZeroDivisionError()
    assert translated(bug, "", tmp_path / "not" / "there") is bug


@pytest.mark.parametrize(
    "words",
    [
        ["--rotation", "nan"],
        ["--rotation=-inf"],
        ["--samples", "1000000000000"],
    ],
)
def test_light_and_pictures_that_cannot_be(tmp_path, words, capsys):
    with pytest.raises(SystemExit) as ending:
        cli.main(["relight", str(tmp_path), "--environment", "city", *words])
    assert ending.value.code == 2
    assert words[0].split("=")[0] in capsys.readouterr().err


def test_a_light_that_looks_like_an_option_is_a_light(tmp_path, monkeypatch):
    heard = []

    def run(words, show):
        heard.extend(words)
        return blender.Outcome(files=(), notes=(), wall=0.0, cpu=0.0)

    monkeypatch.setattr(cli.commands, "_finished", JobPaths)
    monkeypatch.setattr(blender, "run_headless", run)
    assert cli.main(["relight", str(tmp_path), "--environment=--help"]) == 0
    assert heard == ["relight", str(tmp_path), "--environment=--help"]


@pytest.mark.parametrize("command", ["relight", "evaluate"])
def test_a_folder_of_another_user_is_no_bug(tmp_path, monkeypatch, capsys, command):
    def locked(options):
        raise PermissionError(13, "Permission denied", str(tmp_path / "lock"))

    monkeypatch.setattr(cli.commands, command, locked)
    more = ["--environment", "city"] if command == "relight" else []
    assert cli.main([command, str(tmp_path), *more]) == 6
    told = capsys.readouterr().err
    assert told.startswith(f"robir: {tmp_path / 'lock'} cannot be read or written")
    assert "internal error" not in told
