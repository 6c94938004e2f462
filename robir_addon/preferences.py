# SPDX-License-Identifier: GPL-3.0-or-later
"""The add-on's preferences: which engine computes, and the engine they lead to.

`engine_status` is cheap enough for polls and panels; `engine_python` is for the click that starts
work and looks closer. Where RobIR is not enabled as an add-on, as in scripts with the bpy wheel,
the Python that runs the script is the engine.
"""

import sys
import time
from pathlib import Path
from typing import Any

import bpy
from bpy.props import EnumProperty, StringProperty

from . import gateway
from .child import own_folder
from .engine import CAN_INSTALL
from .engine.errors import EngineError, Sentence
from .engine.places import CHOOSE_EXISTING, Place, bundled_wheel, inspect, interpreter
from .engine.states import Status, status
from .paragraphs import advice, paragraph, progress
from .words import told, words

_ENGINES = (
    ("MANAGED", "Made by RobIR", "RobIR downloads and keeps what it needs in one folder"),
    ("EXISTING", "Existing environment", "A Python that has robir and torch already"),
)[not CAN_INSTALL :]

_CHOOSE = "choose one in the add-on's preferences"

# when the engine's state was last asked for to be drawn, and the answer
_shown: list[tuple[float, Status]] = []
_FRESH_SECONDS = 1.0


def _forget_error(_preferences: object, context: bpy.types.Context) -> None:
    """What went wrong with another engine is no news of the one that is chosen now."""
    state = context.window_manager.robir
    state.error = state.error_cure = state.engine_error = state.engine_text = ""
    _shown.clear()


class ROBIR_AP_preferences(bpy.types.AddonPreferences):
    """Which engine computes."""

    bl_idname = __package__

    engine: EnumProperty(
        name="Engine",
        description="The Python that reconstructs, apart from Blender's own",
        items=_ENGINES,
        default=_ENGINES[0][0],
        update=_forget_error,
    )
    python: StringProperty(
        name="Python",
        description="Interpreter of the existing environment, or the environment's folder",
        subtype="FILE_PATH",
        update=_forget_error,
    )
    torch_build: EnumProperty(
        name="Computes with",
        description="Which torch is downloaded",
        items=(
            ("CPU", "Processor", "Works everywhere; 0.5 GB to download"),
            ("CUDA", "NVIDIA graphics card", "Many times faster; 3 GB to download"),
        ),
        default="CPU",
        update=_forget_error,
    )
    wheels: StringProperty(
        name="Folder of wheels",
        description="Install from the wheels in this folder and leave the network alone; "
        "empty downloads them",
        subtype="DIR_PATH",
        update=_forget_error,
    )

    def draw(self, context: bpy.types.Context) -> None:
        layout = self.layout
        layout.use_property_split = True
        layout.prop(self, "engine", expand=True)
        if self.engine == "EXISTING":
            layout.prop(self, "python")
        else:
            layout.prop(self, "torch_build")
            layout.prop(self, "wheels")
        draw_engine(layout.box(), context)


def draw_engine(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    """What computes: whether it works, and how to get it."""
    state, chosen = context.window_manager.robir, preferences_of(context)
    if state.task in ("install", "check_engine", "remove_engine"):
        progress(layout, context)
    elif state.error and state.error == state.engine_error:
        # what went wrong, not what would go wrong again
        advice(layout, context, state.error, state.error_cure, "ERROR")
    else:
        found = shown_engine_status(context)
        icon = "CHECKMARK" if found.state == "ready" else "INFO"
        advice(layout, context, told(found.text), told(found.cure), icon)
        if state.engine_text:
            icon = "CHECKMARK" if state.engine_ok else "ERROR"
            paragraph(layout, context, state.engine_text, icon)
    column = layout.column(align=True)
    column.operator("robir.check_engine", icon="CHECKMARK")
    if CAN_INSTALL and (chosen is None or chosen.engine == "MANAGED"):
        column.operator("robir.install_engine", text=install_text(context), icon="IMPORT")
        column.operator("robir.remove_engine", icon="TRASH")


def install_text(context: bpy.types.Context) -> str:
    """What the button does, how much is downloaded, and how long that takes at 50 Mbit/s."""
    outdated = shown_engine_status(context).state == "outdated"
    chosen = preferences_of(context)
    what = words("Update Engine" if outdated else "Install Engine")
    if chosen is None or chosen.wheels:
        return what
    size, minutes = ("3", 12) if chosen.torch_build == "CUDA" else ("0.5", 4)
    text = "{what} ({size} GB, about {minutes} min)"
    return words(text, what=what, size=size, minutes=minutes)


def preferences_of(context: bpy.types.Context) -> Any:
    """The preferences, or None where RobIR is not enabled as an add-on."""
    addon = context.preferences.addons.get(__package__)
    return None if addon is None else addon.preferences


def managed_place() -> Place:
    """Where the managed engine is or would be; nothing is made."""
    home = own_folder(create=False)
    if home is None:
        raise EngineError(
            "RobIR runs from a folder and not as an installed extension", CHOOSE_EXISTING
        )
    return Place(home / "engine")


def managed_wheel() -> Path:
    """The wheel that the managed engine is made from."""
    wheel = bundled_wheel()
    if wheel is None:
        raise EngineError(
            "this copy of the add-on brings no robir wheel", "install the zip of build_addon.py"
        )
    return wheel


def engine_status(context: bpy.types.Context) -> Status:
    """State of the chosen engine from a look at its files; nothing is run."""
    chosen = preferences_of(context)
    if chosen is None:
        return Status("ready", "The engine is this Python", python=Path(sys.executable))
    try:
        if chosen.engine == "MANAGED":
            return status(managed_place(), managed_wheel(), chosen.torch_build)
        if not chosen.python:
            return Status("missing", "No existing environment is chosen", _CHOOSE)
        python = interpreter(Path(bpy.path.abspath(chosen.python)))
    except EngineError as error:
        return Status("missing", error.message, error.cure)
    return Status("ready", Sentence("The engine is {python}", python=python), python=python)


def shown_engine_status(context: bpy.types.Context) -> Status:
    """`engine_status` for drawing: looks at files once a second at most."""
    now = time.monotonic()
    if not _shown or now - _shown[0][0] > _FRESH_SECONDS:
        _shown[:] = [(now, engine_status(context))]
    return _shown[0][1]


def engine_python(context: bpy.types.Context) -> Path:
    """The interpreter to start a worker with."""
    found = engine_status(context)
    if found.python is None:
        raise EngineError(found.text, found.cure)
    chosen = preferences_of(context)
    if chosen is not None and chosen.engine == "EXISTING":
        inspect(found.python, gateway.__version__)
    return found.python
