# SPDX-License-Identifier: Apache-2.0
"""Fixtures of the extension: its zip, and every Blender it has to work in."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from addon import blenders
from addon.finished import make_result

from robir.jobs.paths import JobPaths


@pytest.fixture(scope="session")
def extension_zip(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The extension as users get it."""
    out = tmp_path_factory.mktemp("extension")
    subprocess.run(
        [sys.executable, blenders.ROOT / "build_addon.py", "--out", out],
        check=True,
        capture_output=True,
    )
    (file,) = out.glob("robir-*.zip")
    return file


def found_or_skipped(series: str) -> blenders.Blender:
    found = blenders.find_blender(series)
    if found is None:
        pytest.skip(f"no Blender {series} on this machine; make blenders fetches it")
    return found


@pytest.fixture
def oldest() -> blenders.Blender:
    """The oldest supported Blender, where one of both is enough."""
    return found_or_skipped(blenders.VERSIONS[0])


@pytest.fixture
def newest() -> blenders.Blender:
    """The newest, likewise."""
    return found_or_skipped(blenders.VERSIONS[-1])


@pytest.fixture(params=(blenders.VERSIONS[0], blenders.VERSIONS[-1]))
def blender(request: pytest.FixtureRequest) -> blenders.Blender:
    """The oldest and the newest supported Blender; one that is not here is skipped."""
    return found_or_skipped(request.param)


@pytest.fixture(scope="session")
def own_blender() -> blenders.Blender:
    """The Blender of the environment that runs the tests."""
    everyone = filter(None, map(blenders.find_blender, blenders.VERSIONS))
    return next(found for found in everyone if found.python == Path(sys.executable))


@pytest.fixture(scope="session")
def exported(tmp_path_factory: pytest.TempPathFactory) -> JobPaths:
    """The sphere's result; made once, and not to be written to."""
    return make_result(tmp_path_factory.mktemp("exported") / "sphere run")


@pytest.fixture(scope="module")
def result(exported: JobPaths, tmp_path_factory: pytest.TempPathFactory) -> JobPaths:
    """The sphere's result for one file of tests, which may add to it."""
    paths = JobPaths(tmp_path_factory.mktemp("run") / exported.root.name)
    shutil.copytree(exported.root, paths.root)
    return paths
