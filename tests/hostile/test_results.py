# SPDX-License-Identifier: Apache-2.0
"""Damaged and tampered result folders: a sentence, nothing else, and nothing outside of them."""

from __future__ import annotations

import json
import os
import random
import shutil

import numpy as np
import pytest
from evaluation import sphere_run
from hostile.damage import NASTY, WHOLE, damage_file, places, replaced

from robir import cli
from robir.capture.arrays import stored_arrays
from robir.capture.store import load_capture, view_path
from robir.errors import (
    CaptureError,
    ConfigError,
    RobirError,
    StorageError,
    UsageError,
)
from robir.evaluation.levels import level_scores
from robir.jobs import client
from robir.jobs.folder import create
from robir.jobs.names import UnsafeNameError, file_in
from robir.jobs.paths import JobPaths, write_json
from robir.jobs.status import StatusWriter
from robir.pipeline.folder import read_config, read_run
from robir.pipeline.ledger import stage_state
from robir_bench.truth.evaluate import evaluate
from robir_bench.truth.files import load_truth


@pytest.fixture(scope="module")
def truth(tmp_path_factory):
    return sphere_run.make_truth(tmp_path_factory.mktemp("capture"))


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    return sphere_run.make_run(tmp_path_factory.mktemp("whole") / "out").root


@pytest.mark.parametrize(
    "name", ["x/../../../pwn", "..", "", "/etc/passwd", "a\0", "a\\b", "\ud800"]
)
def test_names_that_lead_out_are_none(tmp_path, name):
    with pytest.raises(UnsafeNameError):
        file_in(tmp_path, name)
    with pytest.raises(UnsafeNameError):
        view_path(tmp_path, f"x/{name}")
    assert file_in(tmp_path, "r_000.png") == tmp_path / "r_000.png"


def test_every_file_of_a_stage_may_be_damaged(whole, truth, tmp_path):
    """Fifteen damages to files that `evaluate` reads: a sentence or an answer."""
    generator = random.Random(35)
    names = [
        path.relative_to(whole)
        for path in sorted(whole.rglob("*"))
        if path.is_file() and path.suffix in (".json", ".npz")
    ]
    said: list[str] = []
    for number in range(15):
        root = shutil.copytree(whole, tmp_path / str(number))
        damage_file(root / names[number % len(names)], generator)
        try:
            level_scores(JobPaths(root))
            evaluate(JobPaths(root), truth)
        except RobirError as error:
            said.append(str(error))
        shutil.rmtree(root)
    assert len(said) > 5
    words = ("damaged", "cannot be read", "tone", "is missing")
    assert all(any(word in text for word in words) for text in said)


def test_a_view_that_leads_out_is_not_read(whole, tmp_path):
    paths = JobPaths(shutil.copytree(whole, tmp_path / "out"))
    file = paths.stage("capture") / "capture.json"
    content = json.loads(file.read_text())
    content["views"][0]["name"] = "../../../../elsewhere"
    file.write_text(json.dumps(content))
    with pytest.raises(StorageError, match="leads out"):
        load_capture(paths.stage("capture"))


def live_folder(root) -> JobPaths:
    """A folder as a finished run leaves it, as far as its followers look."""
    paths = JobPaths(root)
    root.mkdir()
    StatusWriter(paths).status("done", stage="", fraction=1.0, message="done", exit_code=0)
    write_json(paths.worker, {"started": 1.0, "pid": 2**22, "status_before": None})
    run = {"warnings": [{"stage": "capture", "message": "few views"}]}
    write_json(paths.run, run)
    paths.log.write_text("said\n")
    paths.worker_log.write_text('{"kind": "failed", "message": "no", "exit_code": 3}\n')
    return paths


def test_a_snapshot_never_raises(tmp_path):
    paths = live_folder(tmp_path / "out")
    assert client.snapshot(paths.root).state == "done"
    files = (paths.status, paths.worker, paths.run, paths.worker_log)
    for file in files:
        content = file.read_text()
        document = json.loads(content)
        for place in places(document):
            for value in (*NASTY, ...):
                file.write_text(replaced(document, place, value))
                client.snapshot(paths.root)
        for bytes_ in WHOLE:
            file.write_bytes(bytes_)
            client.snapshot(paths.root)
        file.write_text(content)
    for file in (*files, paths.log, paths.lock):
        content = file.read_bytes() if file.exists() else b""
        for make in (lambda f: f.mkdir(), os.mkfifo, lambda f: f.symlink_to(f.name)):
            file.unlink(missing_ok=True)
            make(file)
            client.snapshot(paths.root)
            file.rmdir() if file.is_dir() else file.unlink()
        file.write_bytes(content)


def test_run_json_without_its_fields_is_damaged(tmp_path):
    paths = JobPaths(tmp_path)
    facts = {"fingerprint": "0", "name": "c", "place": "0", "masks": None}
    run = {"state": "done", "capture": facts, "seconds": {}, "warnings": []}
    run["peak_memory_bytes"] = {}
    write_json(paths.run, run)
    assert read_run(paths) == run
    for place in places(run):
        for value in (3.5, ...):
            paths.run.write_text(replaced(run, place, value))
            with pytest.raises(StorageError, match="damaged"):
                read_run(paths)


@pytest.mark.parametrize(
    "given", [{"masks": "m" * 5000}, {"mesh": {"name": "m" * 5000, "fingerprint": "0"}}]
)
def test_names_of_any_length_in_run_json_open_nothing(tmp_path, capsys, given):
    facts = {"fingerprint": "0", "name": "c", "place": "0", "masks": None} | given
    run = {"state": "done", "capture": facts, "seconds": {}, "warnings": []}
    write_json(JobPaths(tmp_path).run, run | {"peak_memory_bytes": {}})
    words = ["reconstruct", str(tmp_path), "-o", str(tmp_path), "--resume", "--progress", "plain"]
    assert cli.main(words) == 2
    said = capsys.readouterr().err
    (option,) = given
    assert f"was begun with the {option} 'mmm" in said and len(said) < 1000


@pytest.mark.parametrize("outputs", [[], "x", {"a": 1}, {"a\0": {"sha256": "", "bytes": 0}}])
def test_a_manifest_that_is_none_makes_the_stage_stale(tmp_path, outputs):
    paths = JobPaths(tmp_path)
    write_json(paths.manifest("capture"), {"fingerprint": "f", "outputs": outputs})
    assert stage_state(paths, "capture", "f") == "stale"
    paths.manifest("capture").write_text("")
    assert stage_state(paths, "capture", "f") == "stale"


def test_links_out_of_a_result_are_refused(tmp_path):
    paths = live_folder(tmp_path / "out")
    paths.log.unlink()
    (tmp_path / "precious").write_text("mine")
    paths.log.symlink_to(tmp_path / "precious")
    with pytest.raises(UsageError, match="leads out"):
        create(paths)
    assert (tmp_path / "precious").read_text() == "mine"


@pytest.mark.parametrize("name", ["log.txt", "events.jsonl", "export/asset.glb"])
def test_pipes_in_a_result_are_refused(tmp_path, name):
    """Who opens one waits for ever."""
    paths = live_folder(tmp_path / "out")
    paths.export.mkdir()
    (paths.root / name).unlink(missing_ok=True)
    os.mkfifo(paths.root / name)
    with pytest.raises(UsageError, match="neither a file nor a folder"):
        create(paths)


BAD_TOML = {
    "endless": lambda path: path.symlink_to("/dev/zero"),
    "pipe": os.mkfifo,
    "large": lambda path: path.write_bytes(b"#" * (2 << 20)),
    "deep": lambda path: path.write_bytes(b"a=" + b"[" * 100_000),
    "long": lambda path: path.write_bytes(b"a=" + b"1" * 5000),
    "bytes": lambda path: path.write_bytes(b"a='\xff'"),
}


@pytest.mark.parametrize("kind", BAD_TOML)
def test_settings_that_are_none(tmp_path, kind):
    paths = JobPaths(tmp_path)
    BAD_TOML[kind](paths.config)
    with pytest.raises(ConfigError, match=r"config\.toml"):
        read_config(paths)


FORMS = {"a": "f V 3", "b?": "i V", "c": "u1 + * 3|4"}
GOOD = {"a": np.zeros((5, 3)), "b": np.zeros(5, int), "c": np.zeros((2, 0, 4), np.uint8)}


@pytest.mark.parametrize(
    ("name", "array"),
    [
        ("a", np.zeros((5, 2))), ("a", np.zeros(15)), ("a", np.zeros((5, 3), int)),
        ("a", np.full((5, 3), "1.5")), ("a", np.full((5, 3), np.nan)), ("b", np.zeros(4, int)),
        ("c", np.zeros((2, 1, 5), "u1")), ("a", np.zeros((0, 3))),
        ("c", np.zeros((0, 1, 3), "u1")), ("c", np.zeros((2, 1, 3), "u2")), ("a", None),
        ("a", np.full((5, 3), None)),
    ],
)  # fmt: skip
def test_arrays_of_a_result_have_their_form(tmp_path, name, array):
    path = tmp_path / "a.npz"
    np.savez(path, **GOOD, more=np.zeros(1))
    assert stored_arrays(path, FORMS).keys() == GOOD.keys()
    kept = {key: value for key, value in GOOD.items() if key != name}
    np.savez(path, **kept, **({} if array is None else {name: array}))
    with pytest.raises(StorageError, match=r"a\.npz is missing or damaged"):
        stored_arrays(path, FORMS)


@pytest.mark.parametrize(
    ("file", "place", "value"),
    [
        ("truth/scene.json", ("sun_direction",), None),
        ("truth/scene.json", ("lamps",), [{"direction": 3}]),
        ("transforms_test.json", ("frames", 0, "file_path"), 5),
        ("transforms_test.json", ("w",), 10**9),
        ("transforms_test.json", ("frames",), {}),
    ],
)
def test_a_truth_that_is_none(truth, tmp_path, file, place, value):
    copy = shutil.copytree(truth, tmp_path / "copy")
    load_truth(copy)
    (copy / file).write_text(replaced(json.loads((copy / file).read_text()), place, value))
    with pytest.raises(CaptureError, match="cannot be read"):
        load_truth(copy)


@pytest.mark.parametrize(
    "file", ["transforms_test.json", "truth/mesh.ply", "truth/environment.exr", "truth/test/*.exr"]
)
@pytest.mark.parametrize("make", [os.mkfifo, lambda path: path.write_bytes(b"x" * 5000)])
def test_a_truth_of_other_things(truth, tmp_path, file, make):
    copy = shutil.copytree(truth, tmp_path / "copy")
    load_truth(copy)
    path = sorted(copy.glob(file))[0]
    path.unlink()
    make(path)
    with pytest.raises(CaptureError, match="cannot be read"):
        load_truth(copy)
