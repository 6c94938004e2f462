# SPDX-License-Identifier: Apache-2.0
"""One real library, made once, that others are compared with; captures whose engine is a fake."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from hostile.tiny_run import LEAST

from robir.jobs.library import LibraryPaths
from robir.specimen import SETTINGS, write_specimen
from tests.batch.fakes import make_captures, make_template, variables

ABOUT = f"author = 'Ann'\nlicence = 'CC0-1.0'\nsettings = {json.dumps([*SETTINGS, *LEAST])}\n"


@pytest.fixture
def library(tmp_path) -> LibraryPaths:
    return LibraryPaths(tmp_path / "library")


@pytest.fixture
def template(tmp_path) -> Path:
    """The result that the fake engine copies."""
    captures = make_captures(tmp_path / "model", {"a": ""})
    return make_template(tmp_path / "template", captures / "a")


@pytest.fixture(scope="session")
def robir() -> Callable[..., str]:
    """Runs a command of the real command line; what it said on standard output."""

    def run(*words: object, expect: int) -> str:
        command = [sys.executable, "-P", "-m", "robir", *map(str, words)]
        done = subprocess.run(command, capture_output=True, text=True, env=variables(), check=False)
        assert done.returncode == expect, done.stderr[-2000:]
        return done.stdout

    return run


@pytest.fixture(scope="session")
def shots(tmp_path_factory) -> Path:
    """One good capture, one that nobody can use, and their plan."""
    folder = tmp_path_factory.mktemp("shots")
    write_specimen(folder / "sphere")
    (folder / "empty").mkdir()
    (folder / "plan.toml").write_text(
        f"{ABOUT}[[capture]]\npath = 'sphere'\ntags = ['round']\n[[capture]]\npath = 'empty'\n"
    )
    return folder


@pytest.fixture(scope="session")
def at_home(shots, robir, tmp_path_factory) -> LibraryPaths:
    """The library as this machine makes it."""
    library = LibraryPaths(tmp_path_factory.mktemp("home") / "library")
    # 5: nobody sees a sphere's poles, which the quality check minds
    robir("batch", shots / "plan.toml", "-o", library.root, expect=5)
    return library
