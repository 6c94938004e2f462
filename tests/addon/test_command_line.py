# SPDX-License-Identifier: Apache-2.0
"""Commands of a Blender without a window, called as Blender calls them."""

from __future__ import annotations

import json
import signal
import subprocess
import sys

import pytest

import robir

pytestmark = pytest.mark.blender

ROBIR = f"""
import json, os, sys, time
if sys.argv[1] == "-c":  # the add-on asks what it has
    versions = dict(python=[3, 11, 7], robir={robir.__version__!r}, torch="2", numpy="1")
    print(json.dumps(versions))
    raise SystemExit(0)
names = ("ROBIR_BLENDER", "ROBIR_ADDON", "PYTHONPATH")
with open(os.environ["SEEN"], "w") as file:
    json.dump([sys.argv[1:], [os.environ.get(name) for name in names]], file)
if "--slow" in sys.argv:
    import signal
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(130))
    print("started", flush=True)
    time.sleep(600)
print("OUT is finished")
raise SystemExit(3)
"""


@pytest.fixture
def python(tmp_path, monkeypatch):
    """An engine that notes how it was called and ends as if it had rejected the capture."""
    executable = tmp_path / "an engine's python"
    executable.write_text(f"#!{sys.executable} -I\n{ROBIR}", encoding="utf-8")
    executable.chmod(0o755)
    monkeypatch.setenv("SEEN", str(tmp_path / "seen.json"))
    monkeypatch.setenv("PYTHONPATH", "/of/blender's/python")
    return executable


def seen(tmp_path):
    return json.loads((tmp_path / "seen.json").read_text(encoding="utf-8"))


def test_reconstruct_hands_its_words_on_and_ends_with_the_engine_s_code(python, tmp_path, capfd):
    from robir_addon.command_line import reconstruct

    words = ["a capture", "-o", "out", "--device", "cpu", "--set", "seed=1"]
    assert reconstruct([*words[:3], "--engine", str(python), *words[3:]]) == 3
    arguments, environment = seen(tmp_path)
    assert arguments == ["-P", "-m", "robir", "reconstruct", *words]
    assert environment == [None, None, None]
    assert capfd.readouterr().out == "OUT is finished\n"


def test_an_engine_that_cannot_serve_is_said_in_one_sentence(tmp_path, capsys):
    from robir_addon.command_line import reconstruct

    assert reconstruct(["x", "-o", "y", "--engine", str(tmp_path / "nothing")]) == 4
    sentence = capsys.readouterr().err
    assert sentence.startswith("error: ")
    assert str(tmp_path / "nothing") in sentence
    assert sentence.count("\n") == 1


@pytest.mark.parametrize("kind", [signal.SIGINT, signal.SIGTERM])
def test_a_request_to_stop_reaches_the_engine(python, tmp_path, kind):
    code = (
        "import sys; from robir_addon.command_line import reconstruct; "
        "raise SystemExit(reconstruct(sys.argv[1:]))"
    )
    command = [sys.executable, "-c", code, "x", "-o", "y", "--slow", "--engine", python]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "started\n"
        process.send_signal(kind)
        assert process.wait(120) == 130
