# SPDX-License-Identifier: GPL-3.0-or-later
"""The one importer of `robir`: what the extension knows of the core is what stands here.

Blender's Python is shared, so the `robir` it finds need not be the one this extension shipped.
A package that only bears the name, or one of another version, is refused in words.
"""

import importlib
import sys
import tomllib
from pathlib import Path

from .engine.errors import AddonError

_CURE = "install the extension's zip again and restart Blender"


def _shipped_version() -> str | None:
    """Version of the wheel beside this file; None in a checkout, where there is none."""
    manifest = tomllib.loads(
        Path(__file__).with_name("blender_manifest.toml").read_text(encoding="utf-8")
    )
    for wheel in manifest.get("wheels", ()):
        name, version, _ = Path(wheel).name.split("-", 2)
        if name == "robir":
            return version.partition("+")[0]  # without the mark of its content
    return None


def _fault(shipped: str) -> str | None:
    """What is wrong with the `robir` that Python finds, or None if it is the one shipped."""
    try:
        found = importlib.import_module("robir")
    except ModuleNotFoundError:
        return f"the package robir of this extension is missing; {_CURE}"
    place = Path(getattr(found, "__file__", None) or "a folder without code/").parent
    try:
        importlib.import_module("robir.jobs.paths")
        version = found.__version__
    except (ModuleNotFoundError, AttributeError):
        return f"Blender's Python finds another package named robir in {place}; remove that one"
    if version == shipped:
        return None
    return (
        f"this extension needs robir {shipped} and Blender's Python finds {version} in {place}; "
        f"remove that one, or {_CURE}"
    )


def _forget() -> None:
    """Drop what is loaded: an update of the extension changed the files under loaded modules."""
    for name in [n for n in sys.modules if n == "robir" or n.startswith("robir.")]:
        del sys.modules[name]
    importlib.invalidate_caches()


def _require_ours() -> None:
    """Refuse a `robir` that is not the one this extension was built with, by an AddonError."""
    shipped = _shipped_version()
    if shipped is None:
        return
    _forget()
    if fault := _fault(shipped):
        _forget()
        raise AddonError(fault)


_require_ours()

from robir import __version__
from robir.jobs import client, library
from robir.jobs.folder import holder, special_fault
from robir.jobs.names import file_in, leads_out, read_regular
from robir.jobs.paths import (
    STAGES,
    UDIM,
    JobPaths,
    files_of,
    of_tile,
    read_json,
    replacing,
    tiles_there,
    write_json,
)
from robir.jobs.records import CAMERA, NUMBERS, read_record
from robir.jobs.status import Status, read_status

__all__ = [
    "CAMERA", "NUMBERS", "STAGES", "UDIM", "JobPaths", "Status", "__version__", "client",
    "file_in", "files_of", "holder", "leads_out", "library", "of_tile", "read_json",
    "read_record", "read_regular", "read_status", "replacing", "special_fault", "tiles_there",
    "write_json",
]  # fmt: skip
