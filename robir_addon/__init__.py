# SPDX-License-Identifier: GPL-3.0-or-later
"""RobIR in Blender: from photographs to a relit object, without leaving the 3D viewport.

Importing this package has no side effects and needs no Blender; `register` does.
"""

import atexit
import importlib
from types import ModuleType
from typing import Any

_MODULES = (
    "words",
    "panels.properties",
    "preferences",
    "result.summary",
    "work.growth",
    "relighting.lights",
    "work.monitor",
    "work.batch",
    "operators.engine",
    "operators.capture",
    "operators.reconstruct",
    "operators.compare",
    "operators.result",
    "operators.placing",
    "operators.relight",
    "operators.export",
    "operators.library",
    "result.pictures",
    "capture.photographs",
    "panels.sidebar",
    "panels.menus",
    "command_line",
)
"""Parts with classes, pointers, timers or handlers, each after those it builds upon.

A part may have classes named ROBIR_*, `register` and `unregister`, HANDLERS (pairs of a list in
`bpy.app.handlers` and a function) and KEYS (keymap, its space, key, operator, properties).
"""


_registered: list[str] = []
_keys: list[tuple[Any, Any]] = []


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
    while _keys:
        keymap, item = _keys.pop()
        keymap.keymap_items.remove(item)
    while _registered:
        _unregister_part(_registered.pop())


def _register_part(name: str) -> None:
    import bpy

    part = importlib.import_module(f".{name}", __package__)
    for cls in _classes(part):
        bpy.utils.register_class(cls)
    for name, handler in getattr(part, "HANDLERS", ()):
        getattr(bpy.app.handlers, name).append(bpy.app.handlers.persistent(handler))
    keys = bpy.context.window_manager.keyconfigs.addon  # None without a window
    for name, space, key, operator, values in getattr(part, "KEYS", ()) if keys else ():
        keymap = keys.keymaps.new(name=name, space_type=space)
        item = keymap.keymap_items.new(operator.bl_idname, key, "PRESS")
        for field, value in values.items():
            setattr(item.properties, field, value)
        _keys.append((keymap, item))
    if hasattr(part, "register"):
        part.register()


def _unregister_part(name: str) -> None:
    import bpy

    part = importlib.import_module(f".{name}", __package__)
    if hasattr(part, "unregister"):
        part.unregister()
    for name, handler in getattr(part, "HANDLERS", ()):
        getattr(bpy.app.handlers, name).remove(handler)
    for cls in reversed(_classes(part)):
        bpy.utils.unregister_class(cls)


def _classes(part: ModuleType) -> list[type]:
    """What a part makes known to Blender, in its order."""
    named = (thing for name, thing in vars(part).items() if name.startswith("ROBIR_"))
    return [thing for thing in named if thing.__module__ == part.__name__]
