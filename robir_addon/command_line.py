# SPDX-License-Identifier: GPL-3.0-or-later
"""Commands of a Blender without a window.

`blender -b --command robir CAPTURE -o OUT [--engine PYTHON] [OPTION ...]` reconstructs with the
engine of the preferences, or the one given, and ends with the exit codes of `robir reconstruct`,
whose options it takes.

`blender -b --command robir_scene scene|render|relight OUT ...` does what `headless` does. The
engine calls the user's Blender by it, so that it needs no Blender of its own.
"""

import argparse
import signal
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from types import FrameType
from typing import Any

import bpy

from . import gateway, headless
from .engine.errors import EngineError
from .engine.places import clean_environment, inspect, interpreter
from .preferences import engine_python

_STOPS = (signal.SIGINT, signal.SIGTERM)
_handles: list[Any] = []


def worker_environment() -> dict[str, str]:
    """Variables for a process of the engine; it uses this Blender where that has an executable."""
    environment = clean_environment()
    if bpy.app.binary_path:
        environment |= {"ROBIR_BLENDER": bpy.app.binary_path, "ROBIR_ADDON": str(__package__)}
    return environment


def reconstruct(arguments: list[str]) -> int:
    """Run a whole reconstruction; progress and the result's path appear as the engine says them."""
    parser = argparse.ArgumentParser(
        prog="blender -b --command robir",
        usage="%(prog)s CAPTURE -o OUT [--engine PYTHON] [OPTION ...]",
        description="Make a relightable asset of a capture.",
        epilog="Every OPTION is one of `robir reconstruct`, such as --device auto|cpu|cuda, "
        "--set SECTION.KEY=VALUE, --masks DIR, --resume, --progress json.",
        allow_abbrev=False,
    )
    parser.add_argument(
        "--engine",
        type=Path,
        metavar="PYTHON",
        help="Python that has robir and torch; default is the engine of the preferences",
    )
    options, words = parser.parse_known_args(arguments)
    try:
        if options.engine is None:
            python = engine_python(bpy.context)
        else:
            python = interpreter(options.engine)
            inspect(python, gateway.__version__)
    except EngineError as error:
        sys.stderr.write(f"error: {error}, or name one with --engine PYTHON\n")
        return error.exit_code
    return _run_worker([python, "-P", "-m", "robir", "reconstruct", *words])


def _run_worker(command: Sequence[str | Path]) -> int:
    """Run the engine to its end; a request to stop Blender stops the engine, which says so."""
    # in a session of its own: else it gets a terminal's Ctrl-C twice, from here and from there
    with subprocess.Popen(command, env=worker_environment(), start_new_session=True) as worker:

        def stop(_number: int, _frame: FrameType | None) -> None:
            worker.terminate()

        before = {number: signal.signal(number, stop) for number in _STOPS}
        try:
            code = worker.wait()
        finally:
            for number, handler in before.items():
                # Blender's own handlers are unknown to Python, which reports them as None
                signal.signal(number, signal.SIG_DFL if handler is None else handler)
    return code if code >= 0 else 1


def register() -> None:
    """Make the commands known to Blender."""
    for name, command in (("robir", reconstruct), ("robir_scene", headless.main)):
        _handles.append(bpy.utils.register_cli_command(name, command))


def unregister() -> None:
    """Take the commands back."""
    while _handles:
        bpy.utils.unregister_cli_command(_handles.pop())
