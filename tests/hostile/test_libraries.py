# SPDX-License-Identifier: Apache-2.0
"""A stranger's library: nothing outside it is read or written, whatever its entries are."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from robir import cli
from robir.jobs import library as jobs
from robir.jobs.folder import folder_lock, holder
from robir.jobs.library import LibraryPaths


@pytest.fixture
def planned(tmp_path) -> LibraryPaths:
    """A library with a plan of one capture, handed to a farm once."""
    (tmp_path / "cap").mkdir()
    paths = LibraryPaths(tmp_path / "lib")
    assert cli.main(["batch", str(tmp_path / "cap"), "-o", str(paths.root), "--on", "openjd"]) == 0
    return paths


def replaced_by(entry: Path, kind: str, home: Path) -> dict[Path, bytes]:
    """Put a link or a pipe in the place of an entry; what lies outside then."""
    home.mkdir()
    precious = home / "precious"
    precious.write_bytes(b"precious\n")
    if entry.is_dir():
        entry.rename(home / "moved")
        entry.symlink_to(home / "moved" if kind == "folder" else home)
    else:
        entry.unlink(missing_ok=True)
        os.mkfifo(entry) if kind == "pipe" else entry.symlink_to(precious)
    return contents(home)


def contents(home: Path) -> dict[Path, bytes]:
    return {path: path.read_bytes() for path in sorted(home.rglob("*")) if path.is_file()}


ENTRIES = (
    "batch.lock",
    ".batch",
    "openjd",
    "plan.json",
    "index.html",
    "batch.json",
    "cap",
    ".batch/cap.toml",
)


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        *((name, "link") for name in (*ENTRIES, ".batch/cap.toml")),
        ("openjd", "folder"),
        ("plan.json", "pipe"),
    ],
)
def test_links_and_pipes_of_a_library_are_refused(planned, tmp_path, capsys, name, kind):
    before = replaced_by(planned.root / name, kind, tmp_path / "elsewhere")
    root = str(planned.root)
    for words in (["--page"], ["--resume", "--on", "openjd"], ["--task", "0"]):
        assert cli.main(["batch", "-o", root, *words]) == 2
        said = capsys.readouterr().err
        assert "remove it" in said
        assert str(planned.root / name) in said
    if name != "cap":
        for act in (jobs.drop, jobs.prefer):
            with pytest.raises(ValueError, match="remove it"):
                act(planned, "cap")
        with pytest.raises(ValueError, match="remove it"):
            jobs.start_batch(["/bin/false"], [], planned, {})
    assert contents(tmp_path / "elsewhere") == before


def test_a_lock_is_no_link(tmp_path):
    """A link made between the look at the folder and the lock is not followed either."""
    (tmp_path / "precious").write_text("precious")
    (tmp_path / "lock").symlink_to(tmp_path / "precious")
    with pytest.raises(Exception, match="no lock"), folder_lock(tmp_path / "lock"):
        pass
    assert holder(tmp_path / "lock") is None
    assert (tmp_path / "precious").read_text() == "precious"


@pytest.mark.parametrize(
    ("name", "kept"), [(".batch/cap.toml", False), ("blender_assets.cats.txt", True)]
)
def test_files_that_are_no_text_end_nothing(planned, tmp_path, capsys, name, kept):
    file = planned.root / name
    file.write_bytes(b"# \x91\xed\n")
    before = file.read_bytes()
    words = ["--resume", "--on", "openjd", "--format", "blend"]
    assert cli.main(["batch", "-o", str(planned.root), *words]) == 0
    assert file.read_bytes().startswith(before) == kept
