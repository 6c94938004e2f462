# SPDX-License-Identifier: GPL-3.0-or-later
"""Where the extension lies, and Blender work in a process of its own: commands of `headless`."""

import os
import sys
from collections.abc import Sequence
from pathlib import Path

import bpy

# what the wheel's Python runs: an installed extension is a package without a fixed place
_LOAD = """
import sys
from importlib.util import module_from_spec, spec_from_file_location
folder = sys.argv.pop(1)
spec = spec_from_file_location(
    "robir_addon", folder + "/__init__.py", submodule_search_locations=[folder]
)
sys.modules["robir_addon"] = package = module_from_spec(spec)
spec.loader.exec_module(package)
from robir_addon.headless import main
sys.exit(main())
"""


def blender_command(words: Sequence[str]) -> tuple[list[str], dict[str, str]]:
    """Command line and environment variables that run a command of `headless`.

    It is this Blender's executable with this extension, or, where Blender is a module of Python, a
    Python that imports the same modules as this one.
    """
    if bpy.app.binary_path:
        start = [bpy.app.binary_path, "--background", "--disable-autoexec", "--addons", ADDON]
        return [*start, "--command", "robir_scene", *words], dict(os.environ)
    # Blender's own scripts would stand in front of the module that brings them
    own = Path(bpy.utils.resource_path("LOCAL"))
    entries = [Path(entry).absolute() for entry in sys.path]
    search_path = os.pathsep.join(str(e) for e in entries if not e.is_relative_to(own))
    # -P: what this process imports decides, not what lies in the current folder
    start = [sys.executable, "-P", "-c", _LOAD, str(CODE)]
    return [*start, *words], {**os.environ, "PYTHONPATH": search_path}


ADDON = __package__  # name under which Blender knows the extension
CODE = Path(__file__).parent


def own_folder(*, create: bool) -> Path | None:
    """Where what updates leave alone lies; None where RobIR runs from a checkout."""
    try:
        return Path(bpy.utils.extension_path_user(ADDON, create=create))
    except ValueError:
        return None
