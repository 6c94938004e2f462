# SPDX-License-Identifier: GPL-3.0-or-later
"""The one importer of `robir`: what the extension knows of the core is what stands here.

Blender's Python is shared, so the `robir` it finds need not be the one this extension shipped.
A package that only bears the name, or one of another version, is refused in words.
"""

import importlib
import sys
import tomllib
from pathlib import Path

from .errors import AddonError

_CURE = "install the extension's zip again and restart Blender"


def _shipped_version() -> str | None:
    """Version of the wheel beside this file; None in a checkout, where there is none."""
    manifest = tomllib.loads(
        Path(__file__).with_name("blender_manifest.toml").read_text(encoding="utf-8")
    )
    for wheel in manifest.get("wheels", ()):
        name, version, _ = Path(wheel).name.split("-", 2)
        if name == "robir":
            return version
    return None


def _found_version() -> str:
    """Version of the `robir` that Python finds.

    Raises:
        AddonError: If there is none, or one that is not ours.
    """
    try:
        found = importlib.import_module("robir")
    except ModuleNotFoundError as fault:
        raise AddonError(f"the package robir of this extension is missing; {_CURE}") from fault
    try:
        importlib.import_module("robir.jobs.paths")
        return found.__version__
    except (ModuleNotFoundError, AttributeError) as fault:
        place = Path(getattr(found, "__file__", None) or "a folder without code").parent
        raise AddonError(
            f"Blender's Python finds another package named robir in {place}; remove that one"
        ) from fault


def _require_ours() -> None:
    """Refuse a `robir` that is not the one this extension was built with.

    Raises:
        AddonError: If it is missing, foreign, or of another version.
    """
    shipped = _shipped_version()
    if shipped not in (None, _found_version()):
        # An update of the extension changes the files under modules that are still loaded.
        for name in [n for n in sys.modules if n == "robir" or n.startswith("robir.")]:
            del sys.modules[name]
        importlib.invalidate_caches()
    if shipped not in (None, found := _found_version()):
        place = Path(importlib.import_module("robir").__file__ or "").parent
        raise AddonError(
            f"this extension needs robir {shipped} and Blender's Python finds {found} in {place}; "
            f"remove that one, or {_CURE}"
        )


_require_ours()

from robir import __version__
from robir.jobs.paths import STAGES, JobPaths, read_json, replacing, write_json
from robir.jobs.status import Status, read_status

__all__ = [
    "STAGES",
    "JobPaths",
    "Status",
    "__version__",
    "read_json",
    "read_status",
    "replacing",
    "write_json",
]
