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

from . import engine, gateway
from .child import own_folder
from .engine import EngineError, Place, Sentence, Status
from .paragraphs import paragraph
from .words import told, words

_ENGINES = (
    ("MANAGED", "Made by RobIR", "RobIR downloads and keeps what it needs in one folder"),
    ("EXISTING", "Existing environment", "A Python that has robir and torch already"),
)[not engine.CAN_INSTALL :]

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
        state = context.window_manager.robir
        status, box = engine_status(context), layout.box()
        is_at_work = state.task in ("install", "check_engine", "remove_engine")
        error = state.error if state.error == state.engine_error and not is_at_work else ""
        if error:  # what went wrong, not what would go wrong again
            paragraph(box, context, error, "ERROR")
            if state.error_cure:
                paragraph(box, context, state.error_cure, "BLANK1")
        elif not is_at_work:
            icon = "CHECKMARK" if status.state == "ready" else "INFO"
            paragraph(box, context, told(status.text), icon)
            if status.cure:
                cure = told(status.cure)
                paragraph(box, context, f"{cure[:1].upper()}{cure[1:]}", "BLANK1")
        if is_at_work:
            box.progress(factor=state.fraction, type="BAR", text=state.message)
        elif state.engine_text and not error:
            paragraph(box, context, state.engine_text, "CHECKMARK" if state.engine_ok else "ERROR")
        row = box.row(align=True)
        if state.task == "install":
            row.operator("robir.cancel_install", icon="CANCEL")
        elif self.engine == "MANAGED":
            row.operator("robir.install_engine", text=install_text(context), icon="IMPORT")
        row.operator("robir.check_engine", icon="CHECKMARK")
        if self.engine == "MANAGED":
            row.operator("robir.remove_engine", icon="TRASH")


def install_text(context: bpy.types.Context) -> str:
    """What pressing the button does, how much is downloaded and how long that takes.

    Minutes are of a line of 50 Mbit/s, the unpacking included.
    """
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
            "RobIR runs from a folder and not as an installed extension", engine.CHOOSE_EXISTING
        )
    return Place(home / "engine")


def managed_wheel() -> Path:
    """The wheel that the managed engine is made from."""
    wheel = engine.bundled_wheel()
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
            return engine.status(managed_place(), managed_wheel(), chosen.torch_build)
        python = _existing_python(chosen)
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
    status = engine_status(context)
    if status.python is None:
        raise EngineError(status.text, status.cure)
    chosen = preferences_of(context)
    if chosen is not None and chosen.engine == "EXISTING":
        engine.inspect(status.python, gateway.__version__)
    return status.python


def _existing_python(chosen: ROBIR_AP_preferences) -> Path:
    if not chosen.python:
        raise EngineError("No existing environment is chosen", _CHOOSE)
    return engine.interpreter(Path(bpy.path.abspath(chosen.python)))
