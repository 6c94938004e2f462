# SPDX-License-Identifier: GPL-3.0-or-later
"""RobIR in Blender: from photographs to a relit object, without leaving the 3D viewport.

Importing this package has no side effects and needs no Blender; `register` does.
"""

import importlib

_MODULES = ("properties",)
"""Parts with classes, pointers, timers or handlers, each after those it builds upon.

A part has `CLASSES`, or `register` and `unregister`, or both.
"""


def register() -> None:
    """Make the extension known to Blender; if a part fails, those before it are taken back."""
    done: list[str] = []
    try:
        for name in _MODULES:
            _register_part(name)
            done.append(name)
    except Exception:
        for name in reversed(done):
            _unregister_part(name)
        raise


def unregister() -> None:
    """Take everything back, in the opposite order."""
    for name in reversed(_MODULES):
        _unregister_part(name)


def _register_part(name: str) -> None:
    import bpy  # the package is imported without Blender too

    part = importlib.import_module(f".{name}", __package__)
    for cls in getattr(part, "CLASSES", ()):
        bpy.utils.register_class(cls)
    if hasattr(part, "register"):
        part.register()


def _unregister_part(name: str) -> None:
    import bpy

    part = importlib.import_module(f".{name}", __package__)
    if hasattr(part, "unregister"):
        part.unregister()
    for cls in reversed(getattr(part, "CLASSES", ())):
        bpy.utils.unregister_class(cls)
