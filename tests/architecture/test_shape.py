# SPDX-License-Identifier: Apache-2.0
"""Rules about the shape of the code that no linter knows."""

from __future__ import annotations

import ast
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from functools import cache
from pathlib import Path

import pytest

from robir.config import RunConfig

ROOT = Path(__file__).parents[2]
SHIPPED = ("core", "robir_addon", "blender_scenes")
MAX_FILE_LINES = 400
MAX_FUNCTION_LINES = 60
MOST_SETTINGS = 44  # As many as there are: this number only falls. What nobody turns is a constant.

SOURCES = [ROOT / "build_addon.py"]
SOURCES += [path for folder in SHIPPED for path in sorted((ROOT / folder).rglob("*.py"))]
TESTS = sorted((ROOT / "tests").rglob("*.py"))


def name(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


@cache
def parse(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


def functions(path: Path) -> Iterator[ast.FunctionDef | ast.AsyncFunctionDef]:
    for node in ast.walk(parse(path)):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            yield node


def body_lines(function: ast.FunctionDef | ast.AsyncFunctionDef) -> int:
    """Lines from the signature to the end, the docstring not counted."""
    total = (function.end_lineno or function.lineno) - function.lineno + 1
    if ast.get_docstring(function) is not None:
        text = function.body[0]
        total -= (text.end_lineno or text.lineno) - text.lineno + 1
    return total


def test_files_are_short():
    long = {
        name(path): lines
        for path in [*SOURCES, *TESTS]
        if (lines := len(path.read_text(encoding="utf-8").splitlines())) > MAX_FILE_LINES
    }
    assert not long


def test_functions_are_short():
    long = {
        f"{name(path)}:{function.name}": body_lines(function)
        for path in SOURCES
        for function in functions(path)
        if body_lines(function) > MAX_FUNCTION_LINES
    }
    assert not long


def test_every_file_names_its_licence():
    apache, gpl = "Apache-2.0", "GPL-3.0-or-later"
    allowed = {"core": (apache,), "tests": (apache, gpl)}
    for path in [*SOURCES, *TESTS]:
        first = path.read_text(encoding="utf-8").partition("\n")[0]
        licence = first.removeprefix("# SPDX-License-Identifier: ")
        assert licence in allowed.get(name(path).split("/")[0], (gpl,)), name(path)


def public(tree: ast.Module | ast.ClassDef) -> Iterator[ast.AST]:
    for node in tree.body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef) and not node.name.startswith("_"):
            yield node
            if isinstance(node, ast.ClassDef):
                yield from public(node)


# methods that Blender calls, or the bases of operators; these say what they are for
OF_BLENDER = {
    *("poll", "invoke", "execute", "modal", "draw", "draw_header_preset", "poll_drop"),
    *("work", "begin", "start", "clicked"),
}


def is_of_blender(path: Path, node: ast.AST) -> bool:
    return "robir_addon" in path.parts and getattr(node, "name", "") in OF_BLENDER


def test_everything_public_says_what_it_is():
    missing = []
    for path in SOURCES:
        tree = parse(path)
        if not ast.get_docstring(tree):
            missing.append(name(path))
        missing += [
            f"{name(path)}:{node.name}"
            for node in public(tree)
            if isinstance(node, ast.FunctionDef | ast.ClassDef) and not ast.get_docstring(node)
            if not is_of_blender(path, node)
        ]
    assert not missing


def test_no_stage_knows_which_format_photographs_came_in():
    """There is one path for every capture: the reader's name is said in the report, no more."""
    told = {"core/robir/export/report/numbers.py", "core/robir/commands.py"}
    asked = {
        f"{name(path)}:{node.lineno}"
        for path in SOURCES
        if name(path).startswith("core/robir/")
        and not name(path).startswith("core/robir/capture/")
        and name(path) not in told
        for node in ast.walk(parse(path))
        if isinstance(node, ast.Attribute)
        and node.attr == "format"
        and isinstance(node.value, ast.Name)
        and node.value.id == "capture"
    }
    assert not asked


def test_the_add_on_imports_itself_relatively():
    """Blender loads an extension under a name of its own, such as bl_ext.user_default.robir."""
    absolute = [
        f"{name(path)}:{node.lineno}"
        for path in (ROOT / "robir_addon").rglob("*.py")
        for node in ast.walk(parse(path))
        if (isinstance(node, ast.ImportFrom) and not node.level and "robir_addon" in node.module)
        or (isinstance(node, ast.Import) and any("robir_addon" in a.name for a in node.names))
    ]
    assert not absolute


def settings_fields() -> list[tuple[str, str, str]]:
    """Section, field and docstring of the class, of every setting of every room."""
    return [
        (section.name, item.name, type(room).__doc__ or "")
        for section in fields(RunConfig)
        if is_dataclass(room := getattr(RunConfig(), section.name))
        for item in fields(room)
    ]


def public_settings(settings: object) -> int:
    """Settings of a configuration and of all that are nested in it."""
    values = [getattr(settings, item.name) for item in fields(settings)]
    return sum(public_settings(value) if is_dataclass(value) else 1 for value in values)


def test_there_are_no_more_settings_than_before():
    assert public_settings(RunConfig()) <= MOST_SETTINGS


def test_every_setting_is_used_and_explained():
    attributes = {
        node.attr
        for path in (ROOT / "core").rglob("*.py")
        if path.name != "config.py"
        for node in ast.walk(parse(path))
        if isinstance(node, ast.Attribute)
    }
    for section, field, docstring in settings_fields():
        assert field in attributes, f"{section}.{field} is never read"
        assert f"{field}:" in docstring, f"{section}.{field} is not explained"


def loaded_modules(statement: str) -> set[str]:
    """Names of the top-level modules that a fresh interpreter holds after a statement."""
    program = f"{statement}\nimport sys; print(*{{name.split('.')[0] for name in sys.modules}})"
    result = subprocess.run(
        [sys.executable, "-c", program],
        capture_output=True,
        text=True,
        check=True,
        env={"PYTHONPATH": str(ROOT / "core"), "PATH": ""},
    )
    return set(result.stdout.split())


@pytest.mark.parametrize(
    "statement",
    [
        "import robir.jobs.paths, robir.jobs.client, robir.jobs.folder, robir.jobs.context",
        "import robir.config",
        "import robir.cli\ntry: robir.cli.main(['--help'])\nexcept SystemExit: pass",
    ],
)
def test_what_must_start_fast_loads_nothing_heavy(statement):
    heavy = {"torch", "numpy", "scipy", "skimage", "matplotlib", "rich", "bpy"}
    assert not loaded_modules(statement) & heavy


def test_the_stages_never_load_blender():
    statement = "\n".join(
        f"import robir.{stage}.stage"
        for stage in ("capture", "geometry", "transport", "appearance", "export")
    )
    assert "bpy" not in loaded_modules(statement)
