# SPDX-License-Identifier: Apache-2.0
"""Plans: what they say, where they are wrong, and that no path in a library is absolute."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from robir.batch.plan import keep_plan, kept_plan, read_plan
from robir.errors import StorageError, UsageError
from robir.jobs.library import LibraryPaths

PLAN = """
author = "Ann"
settings = ["transport.num_surfels=3000"]

[[capture]]
path = "shots/chair*"
tags = ["chair", "wood"]

[[capture]]
path = "shots/lamp"
name = "Lamp no. 1"
memory = "3G"
masks = "masks/lamp"
catalogue = "lights/desk"
licence = "CC0-1.0"
"""


HERE = LibraryPaths(Path("library"))


@pytest.fixture
def folder(tmp_path):
    for name in ("chair_a", "chair_b", "lamp"):
        (tmp_path / "work" / "shots" / name).mkdir(parents=True)
    (tmp_path / "work" / "shots" / "chair_notes.txt").touch()
    for name in ("masks/lamp", "a/lamp"):
        (tmp_path / "work" / name).mkdir(parents=True)
    return tmp_path / "work"


def written(folder: Path, text: str) -> str:
    path = folder / "PLAN.toml"
    path.write_text(text)
    return str(path)


def test_a_plan_names_captures_with_what_holds_for_all_below(folder):
    plan = read_plan([written(folder, PLAN)], {}, HERE)
    assert [entry.name for entry in plan.entries] == ["chair_a", "chair_b", "Lamp_no._1"]
    lamp = plan.entries[2]
    assert (lamp.author, lamp.licence, lamp.memory) == ("Ann", "CC0-1.0", "3G")
    assert all(entry.config().transport.num_surfels == 3000 for entry in plan.entries)
    assert [entry.catalogue for entry in plan.entries] == ["chair", "chair", "lights/desk"]


def test_no_path_in_a_library_is_absolute(folder, tmp_path):
    paths = LibraryPaths(tmp_path / "library")
    paths.root.mkdir()
    plan = read_plan([written(folder, PLAN)], {}, HERE)
    keep_plan(plan, paths)
    assert str(tmp_path) not in paths.plan.read_text()
    assert kept_plan(paths, None) == plan
    # a library that is moved together with its captures finds them
    moved = tmp_path / "elsewhere"
    moved.mkdir()
    for name in ("library", "work"):
        (tmp_path / name).rename(moved / name)
    there = kept_plan(LibraryPaths(moved / "library"), None)
    assert there.request(there.entries[2], paths).masks == moved / "work" / "masks" / "lamp"
    # and one whose captures lie elsewhere is told so
    assert kept_plan(LibraryPaths(moved / "library"), tmp_path).captures == tmp_path


@pytest.mark.parametrize(
    ("text", "line", "word"),
    [
        ("[[capture]]\npath = 'shots/lamp'\nmemry = '3G'", 3, "did you mean 'memory'"),
        ("[[capture]]\npath = 'shots/lamp'\n\ntags = 'a'", 4, "must be a list"),
        ("author = 3\n[[capture]]\npath = 'shots/lamp'", 1, "author is 3: it must be a string"),
        ("\n[[capture]]\nmemory = '3G'", 2, "no path"),
        ("[[capture]]\npath = 'shots/lamp'\n[[capture]]\npath = 'shots/x*'", 3, "matches no"),
        ("[[capture]]\npath='shots/lamp'\n[[capture]]\npath='a/lamp'", 3, "both become 'lamp'"),
        ("[[capture]]\npath='shots/lamp'\nsettings=['geometry.no=1']", 1, "geometry.no"),
        ("[[capture]]\npath='shots/lamp'\npreset='draft'", 3, "unknown setting 'preset'"),
        ("device='abacus'\n[[capture]]\npath='shots/lamp'", 1, "choose one of 'auto'"),
        ("[[capture]]\npath='shots/lamp'\nmemory='much'", 1, "no size"),
        ("[[capture]]\npath='shots/lamp'\ncatalogue='a//b'", 1, "'a//b' is none"),
        ("[[capture]]\npath = shots/lamp", 2, "not valid TOML"),
        ("[[capture]]\npath = 'shots/gone'", 1, "No such file"),
        ("[[capture]]\npath = '/etc/passwd'", 1, "neither a folder, a video nor"),
        ("[[capture]]\npath = '/dev/zero'", 1, "neither a folder, a video nor"),
        ('[[capture]]\npath = "a\\nb"', 1, "control characters"),
        ('[[capture]]\npath = "a\\u0000b"', 1, "control characters"),
        ("[[capture]]\npath = '***'", 1, "** is not read"),
        ("[[capture]]\npath = '/**'", 1, "** is not read"),
        (f"[[capture]]\npath = '{'x/' * 2500}'", 1, "too long"),
        ("[[capture]]\npath = 'shots/lamp'\nmasks = 'shots/gone'", 1, "no folder of masks"),
        ("[[capture]]\npath = 'shots/lamp'\nname = 'CON'", 1, "Windows keeps it"),
        ("[[capture]]\npath = 'shots/lamp'\nname = 'nul.txt'", 1, "Windows keeps it"),
        ("[[capture]]\npath = 'shots/lamp'\nname = 'PLAN.JSON'", 1, "needs the name"),
        ("[[capture]]\npath = 'shots/lamp'\nname = 'OpenJD'", 1, "needs the name"),
        (f"[[capture]]\npath = 'shots/lamp'\nname = '{'é' * 125}'", 1, "too long"),
        (
            "[[capture]]\npath = 'shots/lamp'\nname = 'Straße'\n"
            "[[capture]]\npath = 'shots/chair_a'\nname = 'STRASSE'",
            4,
            "both become",
        ),
        (f"[[capture]]\npath = 'shots/lamp'\nauthor = '{'x' * 2000}'", 1, "no line of"),
    ],
)
def test_faults_are_named_with_their_line(folder, text, line, word):
    with pytest.raises(UsageError) as fault:
        read_plan([written(folder, text)], {}, HERE)
    assert f"line {line}" in str(fault.value)
    assert word in str(fault.value)


def test_links_to_their_own_folder_are_not_followed(folder):
    for number in range(8):
        (folder / "shots" / f"again{number}").symlink_to(".")
    with pytest.raises(UsageError, match="matches no folder"):
        read_plan([written(folder, f"[[capture]]\npath = 'shots{'/*' * 9}'")], {}, HERE)


def test_names_of_many_bytes_or_of_no_text_are_refused(folder, tmp_path):
    (folder / "many").mkdir()
    (folder / "many" / ("x" * 250)).mkdir()
    with pytest.raises(UsageError, match="too long"):
        read_plan([str(folder / "many" / "*")], {}, HERE)
    Path(os.fsdecode(os.fsencode(folder / "latin") + b"\xe9")).mkdir()
    with pytest.raises(UsageError, match="no valid text"):
        read_plan([str(folder / "latin*")], {}, HERE)


def test_captures_may_be_named_without_a_plan(folder):
    changes = {"memory": "3G", "settings": ["seed=3"]}
    plan = read_plan([str(folder / "shots" / "*")], changes, HERE)
    assert [entry.name for entry in plan.entries] == ["chair_a", "chair_b", "lamp"]
    assert plan.entries[0].config().seed == 3
    assert plan.entries[0].memory == "3G"
    assert plan.captures == folder / "shots"
    with pytest.raises(UsageError, match="no capture"):
        read_plan([], {}, HERE)


@pytest.mark.parametrize(
    "text",
    ["", "[]", "{}", '{"captures": "..", "entries": [{"name": "../../etc", "path": "x"}]}',
     '{"captures": "..", "entries": [{"name": "a", "path": 3}]}',
     '{"captures": 3, "entries": [{"name": "a", "path": "x"}]}',
     '{"captures": "..", "entries": []}',
     '{"captures": "..", "entries": [{"name": "a", "path": "x"}], "device": "abacus"}'],
)  # fmt: skip
def test_a_forged_library_is_refused_in_words(tmp_path, text):
    paths = LibraryPaths(tmp_path)
    paths.plan.write_text(text)
    with pytest.raises(StorageError, match=r"plan\.json is damaged"):
        kept_plan(paths, None)
    paths.plan.unlink()
    with pytest.raises(UsageError, match="holds no batch"):
        kept_plan(paths, None)


def test_a_library_among_the_captures_is_none_of_them(folder):
    paths = LibraryPaths(folder / "shots" / "lamp")
    plan = read_plan([str(folder / "shots" / "*")], {}, paths)
    assert [entry.name for entry in plan.entries] == ["chair_a", "chair_b"]
    (folder / "shots" / "openjd").mkdir()
    with pytest.raises(UsageError, match="the library needs the name openjd"):
        read_plan([str(folder / "shots" / "*")], {}, paths)
