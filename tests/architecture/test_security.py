# SPDX-License-Identifier: Apache-2.0
"""Which files may start programs, open foreign files and read code; docs/security.md lists them."""

from __future__ import annotations

import ast
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[2]
SHIPPED = [ROOT / "build_addon.py"]
for folder in ("core", "robir_addon", "blender_scenes"):
    SHIPPED += sorted((ROOT / folder).rglob("*.py"))

STARTS_PROGRAMS = {
    "build_addon.py",
    "core/robir_bench/crew.py",
    "core/robir_bench/peers/prb.py",
    "core/robir_bench/runs.py",
    "core/robir/batch/farm.py",
    "core/robir/export/blender.py",
    "core/robir/geometry/mesh/child.py",
    "core/robir/jobs/client.py",
    "robir_addon/capture/foreign_mesh.py",
    "robir_addon/command_line.py",
    "robir_addon/engine/install.py",
    "robir_addon/engine/pip.py",
    "robir_addon/engine/places.py",
    "robir_addon/work/task.py",
}


def name(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


@cache
def nodes(path: Path) -> list[ast.AST]:
    return list(ast.walk(ast.parse(path.read_text(encoding="utf-8"))))


@cache
def calls(path: Path) -> list[tuple[str, ast.Call]]:
    return [(ast.unparse(node.func), node) for node in nodes(path) if isinstance(node, ast.Call)]


def test_programs_are_started_from_known_files_only():
    found = {
        name(path)
        for path in SHIPPED
        for node in nodes(path)
        if isinstance(node, ast.Import) and any(a.name == "subprocess" for a in node.names)
    }
    assert found == STARTS_PROGRAMS
    page = (ROOT / "docs/security.md").read_text(encoding="utf-8")
    assert not [file for file in STARTS_PROGRAMS if file not in page]
    for path in SHIPPED:
        for function, call in calls(path):
            assert function not in ("os.system", "os.popen", "eval", "exec"), name(path)
            assert not any(k.arg == "shell" for k in call.keywords), f"{name(path)}:{call.lineno}"


def test_pictures_are_opened_with_their_formats_only():
    """Pillow without `formats` may start another program for what claims to be a photograph."""
    bare = [
        f"{name(path)}:{call.lineno}"
        for path in SHIPPED
        for function, call in calls(path)
        if function == "Image.open" and not any(k.arg == "formats" for k in call.keywords)
    ]
    assert not bare


def test_arrays_hold_no_code():
    for path in SHIPPED:
        for function, call in calls(path):
            if function in ("np.load", "numpy.load"):
                words = {k.arg: ast.unparse(k.value) for k in call.keywords}
                assert words.get("allow_pickle") == "False", f"{name(path)}:{call.lineno}"


def test_no_command_opens_a_blend_file_of_a_result():
    """A scene is made anew of the exported files; a .blend is a program."""
    opened = [f for path in SHIPPED for f, _ in calls(path) if f.endswith("open_mainfile")]
    assert not opened


def test_the_page_on_security_names_the_version():
    from robir import __version__

    text = (ROOT / "SECURITY.md").read_text(encoding="utf-8")
    assert f"version {__version__.rpartition('.')[0]}," in text
