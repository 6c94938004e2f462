# SPDX-License-Identifier: GPL-3.0-or-later
"""What the operators have in common: names, conditions, and how a refusal is said."""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import bpy
from bpy.props import StringProperty

from ..engine.errors import AddonError, EngineError, ResultError
from ..gateway import JobPaths
from ..preferences import engine_status
from ..relighting.lights import world_of
from ..result.importer import active_result, asset_of, mark_of
from ..words import reported, told
from ..work import monitor

_TAB = "RobIR"  # of the sidebar, where the panels are
Need = Callable[[bpy.types.Context], str]
_MixedIn = bpy.types.Operator if TYPE_CHECKING else object


class Operator(_MixedIn):
    """Runs `work`, and turns what it raises into one sentence for the user.

    A class named ROBIR_OT_name becomes `robir.name`, and its docstring the tool-tip.
    """

    bl_options = {"REGISTER", "UNDO"}
    needs: tuple[Need, ...] = ()  # functions of the context that say what is missing, or ""

    def __init_subclass__(cls) -> None:
        """Derive what Blender asks for."""
        kind, _, name = cls.__name__.partition("_OT_")
        if kind == "ROBIR":
            cls.bl_idname = f"robir.{name}"
            cls.bl_description = " ".join((cls.__doc__ or "").split()).removesuffix(".")

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Whether all is there; where not, the tool-tip says what to do."""
        reason = next(filter(None, (need(context) for need in cls.needs)), "")
        if reason:
            cls.poll_message_set(reason)
        return not reason

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Do the work at once."""
        monitor.show_problem("")
        state = context.window_manager.robir
        if not state.task:
            state.message = ""  # what was said of the last click
        try:
            self.work(context)
        except (AddonError, EngineError, OSError) as error:
            return self.refuse(context, told(error))
        return {"FINISHED"}

    def work(self, context: bpy.types.Context) -> None:
        """What the operator is for."""
        raise NotImplementedError

    def refuse(self, context: bpy.types.Context, sentence: str) -> set[str]:
        """Say why nothing was done, in the panel; where that is not seen, in a pop-up."""
        monitor.show_problem(sentence)
        refused(self, context, sentence)
        return {"CANCELLED"}


def folder_property(name: str, description: str) -> Any:
    """A folder that a file browser or a script gives."""
    return StringProperty(
        name=name,
        description=description,
        subtype="DIR_PATH",
        options={"HIDDEN", "SKIP_SAVE"},
    )


class WaitingOperator(Operator):
    """A click does not make the user wait; a script gets what came of it."""

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Begin, and return."""
        return self._begin(context, "INVOKE_DEFAULT")

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Return when it is done."""
        return self._begin(context, "EXEC_DEFAULT")

    def _begin(self, context: bpy.types.Context, way: str) -> set[str]:
        try:
            return self.begin(context, way)
        except AddonError as error:
            return self.refuse(context, told(error))
        except RuntimeError as fault:  # how Blender passes on what another operator reported
            sentence = reported(fault)
            if way == "INVOKE_DEFAULT":
                return self.refuse(context, sentence)
            self.report({"ERROR"}, sentence)
            return {"CANCELLED"}

    def begin(self, context: bpy.types.Context, way: str) -> set[str]:
        """What the operator is for; calls others in a way, INVOKE_DEFAULT or EXEC_DEFAULT."""
        raise NotImplementedError


def refused(operator: bpy.types.Operator, context: bpy.types.Context, sentence: str) -> None:
    """Report what the panel Notice says, unless it is seen, or the preferences, which say it too:
    a pop-up would take the next click.
    """
    areas = context.screen.areas if context.screen and not bpy.app.background else ()
    regions = [r for area in areas if area.type == "VIEW_3D" for r in area.regions]
    tabs = [r.active_panel_category for r in regions if r.type == "UI" and r.width > 1]
    if _TAB not in tabs and (context.area is None or context.area.type != "PREFERENCES"):
        operator.report({"ERROR"}, sentence)


def result_root(context: bpy.types.Context) -> Path:
    """The result folder of the active object, else the one that the panels show, absolute."""
    shown = active_result(context) or bpy.path.abspath(context.scene.robir.result)
    return Path(shown).absolute()


def result_paths(context: bpy.types.Context) -> JobPaths:
    """File names of that result."""
    return JobPaths(result_root(context))


def result_asset(context: bpy.types.Context) -> bpy.types.Object:
    """The imported object of that result."""
    asset = asset_of(result_root(context))
    if asset is None:
        raise ResultError("the object is not in this file; import the result again")
    return asset


def unless(is_met: Callable[[bpy.types.Context], object], sentence: str) -> Need:
    """A condition of operators, with what its tool-tip says where it is not met."""
    return lambda context: "" if is_met(context) else told(sentence)


in_object_mode = unless(
    lambda context: context.mode == "OBJECT", "Leave the present mode for Object Mode first"
)

at_rest = unless(
    lambda context: not (monitor.is_busy() or context.window_manager.robir.task),
    "Wait until the work at hand is done, or cancel it",
)

has_capture = unless(lambda context: context.scene.robir.capture, "Choose a capture first")
has_result = unless(lambda context: context.scene.robir.result, "Import a result first")


def may_choose(context: bpy.types.Context) -> str:
    """A capture can be chosen: while the engine is installed or checked it can, and waits."""
    return "" if is_engine_coming(context) else at_rest(context)


def is_engine_coming(context: bpy.types.Context) -> bool:
    """Whether the engine is being installed or checked."""
    return context.window_manager.robir.task in ("install", "check_engine")


def has_engine(context: bpy.types.Context) -> str:
    """There is an engine, by a look at its files."""
    status = engine_status(context)
    return "" if status.state == "ready" else f"{told(status.text)}: {told(status.cure)}"


def is_imported(context: bpy.types.Context) -> str:
    """The shown result was imported."""
    if reason := has_result(context):
        return reason
    is_there = world_of(mark_of(result_root(context))) is not None
    return "" if is_there else told("The result is not in this file: import it again")
