# SPDX-License-Identifier: Apache-2.0
"""One screen, and one small capture under a name that is hard on careless programs."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from window.blender_window import BlenderWindow
from window.command import Finished, blender, reconstruct
from window.screen import Screen

ROOT = Path(__file__).resolve().parents[2]
# kept after the tests: the add-on's zip in `dist`, screenshots in `pictures`
BUILD = ROOT / "build" / "window"


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Run only where `.ci/window` has set up Blender."""
    if os.environ.get("ROBIR_WINDOW_TESTS") == "1":
        return
    for item in items:
        if item.path.is_relative_to(Path(__file__).parent):
            item.add_marker(pytest.mark.skip(reason="a Blender window: run bash .ci/window"))


@pytest.fixture(scope="session")
def screen() -> Iterator[Screen]:
    """An empty screen."""
    screen = Screen()
    yield screen
    screen.close()


@pytest.fixture(scope="session")
def package() -> Path:
    """The add-on's zip, built from this checkout."""
    (found,) = (BUILD / "dist").glob("robir-*.zip")
    return found


@pytest.fixture(scope="session")
def capture(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The hotdog under a hard sun, 24 views of 96x96, photographed through Filmic."""
    folder = tmp_path_factory.mktemp("captures") / 'Käthe\'s "hot" dog'
    command = [sys.executable, "-m", "blender_scenes", "hotdog", str(folder)]
    size = ["--resolution", "96", "--views", "24", "--test-views", "3", "--samples", "8"]
    subprocess.run([*command, *size, "--view-transform", "Filmic"], check=True, capture_output=True)
    return folder


@pytest.fixture(scope="session")
def home(package: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a user of the command line, with the add-on installed and enabled."""
    folder = tmp_path_factory.mktemp("home of a script")
    done = blender(folder, "extension", "install-file", "-r", "user_default", "-e", package)
    assert done.returncode == 0, done.stderr
    return folder


@contextmanager
def opened(screen: Screen, home: Path, folder: Path, pictures: str) -> Iterator[BlenderWindow]:
    """A window of a user of its own, who has installed the add-on."""
    mine = shutil.copytree(home, folder / "home", symlinks=True)
    window = BlenderWindow(screen, mine, BUILD / pictures)
    window.start()
    yield window
    window.quit()


@pytest.fixture(scope="module")
def window(
    request: pytest.FixtureRequest,
    screen: Screen,
    home: Path,
    tmp_path_factory: pytest.TempPathFactory,
) -> Iterator[BlenderWindow]:
    """Blender with the add-on installed; its engine is the Python of this checkout."""
    pictures = f"pictures-{request.path.stem.removeprefix('test_')}"
    with opened(screen, home, tmp_path_factory.mktemp("user"), pictures) as window:
        window.choose_engine()
        yield window


@pytest.fixture(scope="session")
def finished(home: Path, capture: Path, tmp_path_factory: pytest.TempPathFactory) -> Finished:
    """The capture's result as the command line makes it; not to be written to."""
    return reconstruct(home, capture, tmp_path_factory.mktemp("made") / "the result's folder")
