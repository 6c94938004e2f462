# SPDX-License-Identifier: Apache-2.0
"""Streams, folders and installations that are not as they should be are told as what they are."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from robir import cli
from robir.config import RunConfig
from robir.jobs.paths import JobPaths
from robir.specimen import write_specimen

ROOT = Path(__file__).parents[2]
ROBIR = f"{sys.executable} -P -m robir"


def shell(words: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    variables = {**os.environ, "PYTHONPATH": f"{ROOT / 'core'}{os.pathsep}{ROOT}"}
    command = ["/bin/bash", "-o", "pipefail", "-c", words]
    return subprocess.run(command, capture_output=True, text=True, cwd=cwd, env=variables)


@pytest.mark.parametrize(
    ("redirection", "code", "said"),
    [
        ("| true", 0, ""),
        ("> /dev/full", 6, "standard output cannot be written: No space left"),
        ("2> /dev/full", 0, ""),
        ("2> >(true)", 0, ""),
        ("<&- >&- 2>&-", 0, ""),
    ],
)
def test_streams_that_nobody_reads(tmp_path, redirection, code, said):
    write_specimen(tmp_path / "sphere")
    done = shell(f"{ROBIR} check sphere --json --progress plain {redirection}", tmp_path)
    assert done.returncode == code, done.stderr
    assert said in done.stderr
    assert "Traceback" not in done.stderr and "internal error" not in done.stderr
    assert "Exception ignored" not in done.stderr


@pytest.mark.parametrize("words", ["reconstruct {0}/cap -o {0}/out", "evaluate {0} --truth {0}"])
def test_a_working_folder_that_is_gone(tmp_path, words):
    (tmp_path / "gone").mkdir()
    (tmp_path / "cap").mkdir()
    words = f"cd gone; rmdir ../gone; {ROBIR} {words.format(tmp_path)}"
    done = shell(words, tmp_path)
    assert (done.returncode, done.stdout) == (2, "")
    assert "the working folder has been deleted" in done.stderr


@pytest.mark.skipif(shutil.which("setpriv") is None, reason="it takes root's rights away")
@pytest.mark.parametrize("barred", ["cap", "cap/train", "cap/train/view_00.png"])
def test_what_a_user_may_not_read_is_named(tmp_path, barred):
    write_specimen(tmp_path / "cap")
    (tmp_path / barred).chmod(0)
    as_user = "setpriv --bounding-set=-dac_override,-dac_read_search" if os.getuid() == 0 else ""
    done = shell(f"{as_user} {ROBIR} check cap --progress plain", tmp_path)
    (tmp_path / barred).chmod(0o755)
    assert done.returncode == 3
    assert f"{barred} cannot be read" in done.stdout + done.stderr
    assert "Errno" not in done.stdout and "internal error" not in done.stderr


@pytest.mark.parametrize("word", ["caf\udce9", "a\ud800"])
def test_names_that_are_no_text(word, capsys):
    with pytest.raises(SystemExit) as ending:
        cli.main(["check", word])
    assert ending.value.code == 2
    assert "no path of valid text" in capsys.readouterr().err


def test_the_settings_of_a_strangers_folder_open_no_other_files(tmp_path):
    """That photographs may lie elsewhere is said on the command line, each time."""
    from argparse import Namespace

    from robir.commands import _settings
    from robir.jobs.paths import write_json
    from robir.settings import toml_from_settings

    paths = JobPaths(tmp_path)
    run = {"state": "running", "seconds": {}, "peak_memory_bytes": {}}
    run |= {"capture": {"name": "c", "place": "0", "masks": None, "fingerprint": ""}}
    run |= {"warnings": []}
    write_json(paths.run, run)
    text = toml_from_settings(RunConfig()).replace('outside = "refuse"', 'outside = "take"')
    assert 'outside = "take"' in text
    paths.config.write_text(text)
    options = Namespace(
        out=tmp_path, resume=True, defaults=False, masks=None, mesh=None, config=None,
        assignments=[], constants=[], seed=None,
    )  # fmt: skip
    assert _settings(options)[0].capture.outside == "refuse"
    options.assignments = ["capture.outside=take"]
    assert _settings(options)[0].capture.outside == "take"
