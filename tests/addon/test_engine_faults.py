# SPDX-License-Identifier: Apache-2.0
"""What the engine says when something is wrong, each with the cure; nothing is installed here."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
from argparse import Namespace
from pathlib import Path
from types import SimpleNamespace

import pytest
from addon.wheelhouse import CONSTRAINTS

import robir
from robir_addon.engine import install as installer
from robir_addon.engine import places
from robir_addon.engine.errors import EngineError
from robir_addon.engine.pip import Pip, _Meter
from robir_addon.engine.places import Place, base_python, inspect, worker_command
from robir_addon.engine.states import Record, read_record, write_record


@pytest.fixture
def words(tmp_path, monkeypatch):
    """An installation from the network, onto a disk with room."""
    monkeypatch.setattr(shutil, "disk_usage", lambda folder: SimpleNamespace(free=100 << 30))
    wheel = tmp_path / "robir-1.2.3-py3-none-any.whl"
    wheel.write_bytes(b"wheel")
    return [
        *("--root", str(tmp_path / "engine"), "--wheel", str(wheel), "--torch", "CPU"),
        *("--constraints", str(CONSTRAINTS), "--online"),
    ]


def refused(words, capsys):
    """The error and the cure of an installation that does not start."""
    assert installer.main(words) == 4
    last = json.loads(capsys.readouterr().out.splitlines()[-1])
    return last["error"], last["cure"]


def test_little_room_is_noticed_before_anything_is_made(words, capsys, monkeypatch, tmp_path):
    monkeypatch.setattr(shutil, "disk_usage", lambda folder: SimpleNamespace(free=1 << 30))
    error, cure = refused(words, capsys)
    assert "has 1.0 GB free, the engine needs about 3 GB" in error
    assert "make room" in cure
    assert not (tmp_path / "engine/env").exists()


class _Begun(Exception):
    """The first step has begun."""


def begin(*_):
    raise _Begun


@pytest.mark.parametrize(("chosen", "begins"), [("CPU", True), ("CUDA", False)])
def test_an_update_needs_no_room_for_another_torch(
    words, capsys, monkeypatch, tmp_path, chosen, begins
):
    """An engine that is refused another torch is what it was."""
    place = Place(tmp_path / "engine")
    installer._take_folder(place)
    record = Record("1.2.2", "0", "CPU", "2.13.0+cpu", "2.0", "3.11")
    write_record(place, record)
    monkeypatch.setattr(shutil, "disk_usage", lambda folder: SimpleNamespace(free=1 << 30))
    monkeypatch.setattr(installer, "_environment_with_pip", begin)
    words[words.index("CPU")] = chosen
    if begins:
        with pytest.raises(_Begun):
            installer.main(words)
    else:
        assert "has 1.0 GB free, the engine needs about 11 GB" in refused(words, capsys)[0]
        assert read_record(place) == record


def test_a_disk_that_fills_up(words, capsys, monkeypatch):
    def fill(*_):
        raise OSError(28, "No space left on device", "/engine/env/torch.so")

    monkeypatch.setattr(installer, "_install", fill)
    error, cure = refused(words, capsys)
    assert error == "/engine/env/torch.so cannot be written (No space left on device)"
    assert "goes on where it stopped" in cure


@pytest.mark.parametrize("executable", ["", None, "/opt/blender/blender"])
def test_a_blender_without_a_python(monkeypatch, executable):
    monkeypatch.setattr(sys, "executable", executable)
    with pytest.raises(EngineError, match="without a Python to run; choose an existing"):
        worker_command()


@pytest.fixture
def too_new(monkeypatch, tmp_path):
    """Blender's Python is one that the engine's parts are not offered for; PATH is a folder."""
    monkeypatch.setattr(places, "NEWEST", (3, 10))
    monkeypatch.setattr(places, "OLDEST", (3, 8))
    monkeypatch.setenv("PATH", str(tmp_path))

    def install(release: str, code: str) -> Path:
        program = tmp_path / f"python{release}"
        program.write_text(f"#!/bin/sh\n{code}\n")
        program.chmod(0o755)
        return program

    return install


def test_an_engine_of_another_python_where_blenders_is_too_new(too_new):
    too_new("3.10", "exit 1")  # one without ensurepip
    too_new("3.9", f'exec "{sys.executable}" "$@"')
    too_new("3.8", "echo never asked")
    assert base_python() == Path(sys.executable)
    command = worker_command("--help", python=base_python())
    said = subprocess.run(command, capture_output=True, text=True, check=True)
    assert "--torch" in said.stdout


def test_what_to_install_is_said_where_no_other_python_is_there(too_new):
    with pytest.raises(
        EngineError, match="Python {}.{}, Blender's own".format(*sys.version_info)
    ) as fault:
        base_python()
    assert "python3.10-venv" in fault.value.cure


CPU_LABEL = ["--no-deps", "--index-url", installer.CPU_INDEX]
CUDA_LABEL = ["--no-deps", "--index-url", installer.CUDA_INDEX]
PINNED = ["--require-hashes", "--no-deps", "--requirement", "lists/hashes-torch.txt"]


@pytest.mark.parametrize(
    ("platform", "build", "wheels", "expected"),
    [
        ("linux", "CPU", None, ["torch==2.13.0+cpu", *CPU_LABEL]),
        ("linux", "CUDA", None, PINNED),
        ("win32", "CPU", None, PINNED),
        ("win32", "CUDA", None, ["torch==2.13.0+cu130", *CUDA_LABEL]),
        ("darwin", "CPU", None, PINNED),
        ("linux", "CPU", Path("wheels"), ["torch", "--constraint", str(CONSTRAINTS)]),
    ],
)
def test_torch_for_each_system(monkeypatch, platform, build, wheels, expected):
    """Never the larger one by chance, never one that cannot use the card."""
    monkeypatch.setattr(sys, "platform", platform)
    options = Namespace(torch=build, wheels=wheels, constraints=CONSTRAINTS, hashes=Path("lists"))
    assert installer._torch_words(options) == expected


@pytest.mark.parametrize(
    ("lines", "wheels", "error", "cure"),
    [
        (["OSError: [Errno 28] No space left on device"], None, "disk is full", "make room"),
        (
            ["HINT: this system does not have Windows Long Path support enabled."],
            None,
            "long names",
            "LongPathsEnabled",
        ),
        (
            ["WARNING: Retrying after SSLError(SSLCertVerificationError(1, 'CERTIFICATE_VERIFY_"],
            None,
            "not trusted",
            "PIP_CERT",
        ),
        (["ERROR: THESE PACKAGES DO NOT MATCH THE HASHES"], None, "damaged", "goes on"),
        (
            ["WARNING: Retrying ... NewConnectionError(", "ERROR: No matching distribution found"],
            None,
            "cannot be reached while torch",
            "is online",
        ),
        (["pip._vendor.urllib3.exceptions.ReadTimeoutError: timed out"], None, "broke off", "netw"),
        (["PermissionError: [WinError 5] Access is denied"], None, "cannot be written", "close"),
        (["/e/env/bin/python: No module named pip"], None, "is damaged", "Remove Engine"),
        (["ERROR: No matching distribution found for xatlas==0.0.11"], None, "offers xatlas", "ex"),
        (
            ["ERROR: No matching distribution found for xatlas==0.0.11"],
            Path("/wheels"),
            "lacks xatlas==0.0.11",
            "/wheels",
        ),
        (
            ["    The user requested (constraint) numpy==1.26.4", "ERROR: ResolutionImpossible"],
            Path("/wheels"),
            "lacks numpy==1.26.4",
            "/wheels",
        ),
        (["ERROR: something new", "more"], None, "(something new)", "install.log"),
    ],
)
def test_what_pip_says_in_words(tmp_path, lines, wheels, error, cure):
    fault = Pip(Place(tmp_path), wheels)._reason("torch", lines)
    assert error in fault.message
    assert cure in fault.cure


def test_progress_is_read_from_what_pip_says():
    told = []
    meter = _Meter(8 << 20, lambda share, text: told.append((round(share, 3), text)), "torch")
    for line in (
        "Collecting torch",
        "Downloading https://files.example/torch-2.13.0%2Bcpu-cp311-cp311-linux_x86_64.whl (6 MB)",
        "Progress 0 of 6291456",
        "Progress 4194304 of 6291456",
        "Progress 6291456 of 6291456",
        "Using cached sympy-1.14.0-py3-none-any.whl (6 MB)",
        "Progress 6291456 of 6291456",
        "Installing collected packages: sympy, torch",
    ):
        meter(line)
    assert told == [
        (0.0, "looking for torch"),
        (0.0, "fetching torch 2.13.0+cpu"),
        (0.0, "downloading torch 2.13.0+cpu, 0 of 6 MB"),
        (0.45, "downloading torch 2.13.0+cpu, 4 of 6 MB"),
        (0.675, "downloading torch 2.13.0+cpu, 6 of 6 MB"),
        (0.675, "fetching sympy 1.14.0"),
        (0.9, "downloading sympy 1.14.0, 6 of 6 MB"),
        (0.92, "unpacking torch, which takes a while"),
    ]


def test_a_stop_while_pip_starts_leaves_no_pip_behind(tmp_path, monkeypatch):
    started, real = [], subprocess.Popen

    def start(*_, **__):
        words = [sys.executable, "-c", "import time; time.sleep(60)"]
        started.append(real(words, stdout=subprocess.PIPE, text=True))
        signal.raise_signal(signal.SIGTERM)
        return started[0]

    monkeypatch.setattr(subprocess, "Popen", start)
    with installer._stopped_by_signals(), pytest.raises(KeyboardInterrupt):
        Pip(Place(tmp_path), None)._run(["list"])
    assert started[0].poll() not in (None, 0)


def pretender(folder: Path, facts: dict | str, code: int = 0) -> Path:
    """A program that answers as a Python would."""
    file = folder / "a 'python' é"
    said = facts if isinstance(facts, str) else json.dumps(facts)
    file.write_text(f"#!/bin/sh\ncat <<'END'\n{said}\nEND\nexit {code}\n", encoding="utf-8")
    file.chmod(0o755)
    return file


WHOLE = {"python": [3, 11, 7], "robir": "0.5.0", "torch": "2.9.0", "numpy": "1.26.4"}


@pytest.mark.skipif(os.name == "nt", reason="shell scripts")
@pytest.mark.parametrize(
    ("facts", "error", "cure"),
    [
        (WHOLE | {"python": [3, 9, 2]}, "is Python 3.9.2, RobIR needs 3.11 or newer", "another"),
        (WHOLE | {"robir": None}, "has no robir", "pip install and the robir 0.5.0 wheel"),
        (WHOLE | {"robir": "0.4.0"}, "has robir 0.4.0, this add-on needs 0.5.0", "0.5.0 wheel"),
        (WHOLE | {"torch": None}, "has no torch", "-m pip install torch"),
        (WHOLE | {"numpy": None}, "has no numpy", "-m pip install numpy"),
        ("I am no Python", "is not a Python that works", "choose another"),
    ],
)
def test_an_environment_that_lacks_something(tmp_path, facts, error, cure):
    with pytest.raises(EngineError) as caught:
        inspect(pretender(tmp_path, facts), "0.5.0")
    assert error in caught.value.message
    assert cure in caught.value.cure


@pytest.mark.skipif(os.name == "nt", reason="shell scripts")
def test_an_environment_that_has_everything(tmp_path):
    assert inspect(pretender(tmp_path, WHOLE), "0.5.0").torch == "2.9.0"
    assert inspect(Path(sys.executable), robir.__version__).robir == robir.__version__
