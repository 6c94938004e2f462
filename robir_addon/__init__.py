# SPDX-License-Identifier: GPL-3.0-or-later
"""RobIR in Blender: from photographs to a relit object, without leaving the 3D viewport.

Importing this package has no side effects and needs no Blender; `register` does.
"""

import atexit
import importlib

_MODULES = (
    "words",
    "panels.properties",
    "preferences",
    "result.summary",
    "work.growth",
    "relighting.pictures",
    "work.monitor",
    "capture.recent",
    "work.batch",
    "operators.engine",
    "operators.capture",
    "operators.sample",
    "operators.photographs",
    "operators.notice",
    "operators.reconstruct",
    "operators.known",
    "operators.compare",
    "operators.result",
    "operators.placing",
    "operators.relight",
    "operators.export",
    "operators.library",
    "result.captions",
    "panels.dropping",
    "capture.photographs",
    "panels.notices",
    "panels.sidebar",
    "panels.known",
    "panels.menus",
    "command_line",
)
"""Parts with classes, pointers, timers or handlers, each after those it builds upon.

A part has `CLASSES`, or `register` and `unregister`, or both.
"""


_registered: list[str] = []


def register() -> None:
    """Make the extension known to Blender; if a part fails, those before it are taken back."""
    import bpy  # the package is imported without Blender too

    try:
        for name in _MODULES:
            _register_part(name)
            _registered.append(name)
    except Exception:
        unregister()
        raise
    if not bpy.app.binary_path:  # the wheel crashes at its end over properties still there
        atexit.register(unregister)


def unregister() -> None:
    """Take everything back, in the opposite order."""
    atexit.unregister(unregister)
    while _registered:
        _unregister_part(_registered.pop())


def _register_part(name: str) -> None:
    import bpy

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
