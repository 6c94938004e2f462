# SPDX-License-Identifier: Apache-2.0
"""Runs a piece of code in each of several Blender versions, each with a fresh user folder.

A version is the `bpy` wheel in an environment of its own: the one that runs the tests, and those
that `make blenders` made. Nothing of the checkout is importable there, as with a user's Blender;
what such a run knows of RobIR is what the extension's zip brought.
"""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[2]
MODULE = "bl_ext.user_default.robir"
VERSIONS = ("4.2", "4.5", "5.2")

_DRIVER = """
import json, sys
task = json.load(open(sys.argv[1], encoding="utf-8"))
sys.path += task["search"]
space = {"__name__": "script"}
exec(compile(task["script"], "<script>", "exec"), space)
answer = json.dumps(space["main"](*task["arguments"]))
with open(task["answer"], "w", encoding="utf-8") as file:
    file.write(answer)
"""


@dataclass(frozen=True)
class Blender:
    """A Python that can import bpy."""

    version: str  # of the wheel, as in "4.5.15"
    python: Path  # the interpreter
    site_packages: Path  # where its bpy lies


def sessions(*names: str) -> str:
    """Files of this folder as one text, as they cannot import each other there."""
    texts = [(Path(__file__).parent / f"{name}.py").read_text(encoding="utf-8") for name in names]
    return re.sub(r"(?m)^from (recording|\w+_session) import .*$", "", "\n".join(texts))


def find_blender(series: str) -> Blender | None:
    """The Blender of a series such as "4.5", or None if this machine has none."""
    for python in (Path(sys.executable), ROOT / f".venv-blender/{series}/bin/python"):
        for mark in python.parents[1].glob(f"lib/python*/site-packages/bpy-{series}.*.dist-info"):
            version = mark.name.removeprefix("bpy-").removesuffix(".dist-info")
            return Blender(version, python, mark.parent)
    return None


def run(blender: Blender, script: str, *arguments: Any, user: Path) -> Any:
    """Run a script in a process of its own.

    Args:
        blender: Which Blender.
        script: Source code that defines `main(*arguments)`; it imports bpy itself.
        *arguments: Plain values, handed over as JSON.
        user: Blender's folder of preferences and extensions; made if it is missing.

    Returns:
        What `main` returned, through JSON.

    Raises:
        AssertionError: If the process failed; holds the end of what it printed.
    """
    user.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        task, answer = Path(folder) / "task.json", Path(folder) / "answer.json"
        content = {
            "script": script,
            "arguments": arguments,
            "search": [str(blender.site_packages)],
            "answer": str(answer),
        }
        task.write_text(json.dumps(content), encoding="utf-8")
        # -I and -S: neither the checkout nor a .pth file that points to it is seen
        done = subprocess.run(
            [blender.python, "-I", "-S", "-B", "-c", _DRIVER, task],
            capture_output=True,
            text=True,
            encoding="utf-8",
            errors="replace",
            timeout=600,
            check=False,
            env={**os.environ, "BLENDER_USER_RESOURCES": str(user)},
        )
        # Blender 4.2 crashes at its very end where a property group with an update function was
        # uninstalled, whosever it was; what was to be done is done by then
        is_known_crash = blender.version.startswith("4.2.") and done.returncode == -signal.SIGSEGV
        said = f"{done.stdout[-3000:]}\n{done.stderr[-5000:]}"
        assert done.returncode == 0 or (is_known_crash and answer.exists()), (
            f"Blender {blender.version} ended with {done.returncode}\n{said}"
        )
        return json.loads(answer.read_text(encoding="utf-8"))
