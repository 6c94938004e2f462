# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators of the engine: install, cancel, check, remove; and of notices, which lead to it.

Installation and check are tasks of `monitor`: subprocesses that say how far they are, and at last
what came of it, one JSON object a line. A click returns at once; a script waits for them.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import bpy

from ..engine.errors import AddonError, EngineError, Sentence
from ..engine.places import base_python, constraints, worker_command
from ..engine.states import read_record
from ..preferences import engine_python, engine_status, managed_place, managed_wheel, preferences_of
from ..words import told
from ..work import monitor
from ..work.worker import in_panel_words
from .capture import look_at_waiting
from .shared import Operator, WaitingOperator, at_rest, has_engine, refused, unless

OFFLINE = "Blender is not allowed to go online"
_ALLOW = (
    "turn on Allow Online Access in Preferences > System, or give a folder of wheels in the "
    "add-on's preferences"
)
_RESTART = "start Blender without --offline-mode, or give a folder of wheels"
_CANCELLED = 130
Run = Callable[..., None]


class _Task:
    """A subprocess of the engine: what it says goes to the window manager's state."""

    def __init__(self, what: Sentence, succeed: Callable[[dict[str, Any]], None]) -> None:
        """Clear what the last task left."""
        self._what, self._succeed = what, succeed
        self._last: dict[str, Any] = {}
        _tell("", "")

    def on_line(self, report: dict[str, Any]) -> None:
        """Keep the last report, which is the outcome."""
        if "progress" not in report:
            self._last = report

    def on_end(self, code: int, complaint: str) -> None:
        """Show the outcome."""
        if code == _CANCELLED:  # what there is now, and how to go on, is said beside it
            state = bpy.context.window_manager.robir
            state.engine_ok = False
            state.engine_text = told("{work} was cancelled", work=self._what)
        elif "error" in self._last:
            _tell(self._last["error"], self._last["cure"])
        elif self._last:
            self._succeed(self._last)
        else:
            said = (complaint.splitlines() or [told("it ended with code {code}", code=code)])[-1]
            problem = told("{work} failed: {said}", work=self._what, said=said)
            _tell(problem, told("remove the engine and install it again"))


def _installed(_outcome: dict[str, Any]) -> None:
    state = bpy.context.window_manager.robir
    state.engine_ok = False
    state.engine_text = told(engine_status(bpy.context).text)
    if not bpy.app.background:
        _check(bpy.context, monitor.run_task)


def _checked(outcome: dict[str, Any]) -> None:
    state = bpy.context.window_manager.robir
    state.engine_ok = outcome["ok"]
    state.engine_text = describe(outcome)
    if not outcome["ok"]:
        _tell(outcome["message"], outcome["cure"])
    else:
        look_at_waiting(bpy.context)


def _removed(outcome: dict[str, Any]) -> None:
    state = bpy.context.window_manager.robir
    state.engine_text, state.engine_ok = "", False
    left = ", ".join(outcome["left"])
    _tell(told("Not RobIR's and left in place: {names}", names=left) if left else "", "")


def _is_managed(context: bpy.types.Context) -> str:
    """The engine is one that RobIR makes."""
    chosen = preferences_of(context)
    if chosen is None:
        return told("RobIR is not enabled as an add-on; the engine is this Python")
    if chosen.engine != "MANAGED":
        return told("An existing environment is chosen in the preferences")
    try:
        managed_place()
        managed_wheel()
    except EngineError as error:
        return f"{_sentence(told(error.message))}: {told(error.cure)}"
    return ""


_is_wanted = unless(lambda c: engine_status(c).state != "ready", "The engine is installed")
_is_there = unless(lambda c: engine_status(c).state != "missing", "There is no engine to remove")


class _EngineOperator(Operator):
    """Starts a task; its outcome is in the state, and what went wrong becomes the report."""

    bl_options = {"REGISTER"}

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        return self._run(context, monitor.run_task)

    def execute(self, context: bpy.types.Context) -> set[str]:
        return self._run(context, monitor.wait_task)

    def start(self, context: bpy.types.Context, run: Run) -> None:
        """Start the task."""
        raise NotImplementedError

    def _run(self, context: bpy.types.Context, run: Run) -> set[str]:
        try:
            self.start(context, run)
        except EngineError as error:
            _tell_error(error)
        state = context.window_manager.robir
        if not state.error:
            return {"FINISHED"}
        cure = f"; {state.error_cure}" if state.error_cure else ""
        refused(self, context, f"{state.error}{cure}")
        return {"CANCELLED"}


class ROBIR_OT_install_engine(_EngineOperator, bpy.types.Operator):
    """Download what reconstructs into a folder of its own; Blender's Python stays as it is."""

    bl_label = "Install Engine"
    needs = (_is_managed, at_rest, _is_wanted)

    def start(self, context: bpy.types.Context, run: Run) -> None:
        command = _install_command(context)
        _start(run, "install", command, _Task(Sentence("The installation"), _installed))


class ROBIR_OT_check_engine(_EngineOperator, bpy.types.Operator):
    """Make a tiny reconstruction, and say the device, its memory and the versions, or what is wrong
    and what to do.
    """

    bl_label = "Check Engine"
    needs = (has_engine, at_rest)

    def start(self, context: bpy.types.Context, run: Run) -> None:
        _check(context, run)


class ROBIR_OT_remove_engine(_EngineOperator, bpy.types.Operator):
    """Remove the engine that RobIR made, and nothing else."""

    bl_label = "Remove Engine"
    needs = (_is_managed, at_rest, _is_there)

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        return context.window_manager.invoke_confirm(
            self,
            event,
            title="Remove the engine?",
            message=what_goes(),
            confirm_text="Remove",
            icon="WARNING",
        )

    def execute(self, context: bpy.types.Context) -> set[str]:
        # what a confirmed question runs; only a script waits
        return self._run(context, monitor.wait_task if bpy.app.background else monitor.run_task)

    def start(self, context: bpy.types.Context, run: Run) -> None:
        command = worker_command(str(managed_place().root), module="remove")
        _start(run, "remove_engine", command, _Task(Sentence("The removal"), _removed))


def what_goes() -> str:
    """Folder and size of the managed engine, for whoever is asked whether it may go."""
    place = managed_place()
    record = read_record(place)
    if record is None or not record.size:
        return str(place.root)
    return told("{size:.1f} GB in {folder}", size=record.size / 2**30, folder=place.root)


def describe(verdict: dict[str, Any]) -> str:
    """What a check found, in one sentence: what computes, the versions, how Cycles runs."""
    facts = [verdict["message"]]
    if verdict["memory_bytes"]:
        free, total = (verdict[name] / 2**30 for name in ("free_memory_bytes", "memory_bytes"))
        text = "{free:.1f} of {total:.1f} GB memory free" if free else "{total:.1f} GB"
        facts.append(told(text, free=free, total=total))
    names = {"robir": "RobIR", "torch": "torch", "numpy": "numpy", "python": "Python"}
    versions = [f"{text} {verdict[name]}" for name, text in names.items() if verdict[name]]
    facts += [", ".join(versions), f"Cycles: {verdict['blender']}"]
    return _sentence(in_panel_words("; ".join(facts)))


def _install_command(context: bpy.types.Context) -> list[str]:
    """The command, if the user allows what it does."""
    chosen, place = preferences_of(context), managed_place()
    words = ["--root", str(place.root), "--wheel", str(managed_wheel())]
    words += ["--constraints", str(constraints()), "--torch", chosen.torch_build]
    if chosen.wheels:
        folder = Path(bpy.path.abspath(chosen.wheels))
        if not folder.is_dir():
            text = "The folder of wheels {folder} does not exist"
            cure = "choose another in the add-on's preferences, or empty the field to download"
            raise EngineError(text, cure, folder=folder)
        return worker_command(*words, "--wheels", str(folder), python=base_python())
    if not bpy.app.online_access:
        raise EngineError(OFFLINE, _RESTART if bpy.app.online_access_override else _ALLOW)
    return worker_command(*words, "--online", python=base_python())


def _check(context: bpy.types.Context, run: Run) -> None:
    try:
        python = engine_python(context)
    except EngineError as error:
        _tell_error(error)
        return
    task = _Task(Sentence("The check of the engine"), _checked)
    words = ["selftest", "--json", "--device", context.scene.robir.device]
    command = [str(python), "-P", "-m", "robir", *words]
    _start(run, "check_engine", command, task)


def _start(run: Run, name: str, command: list[str], task: _Task) -> None:
    try:
        run(name, command, task.on_line, task.on_end)
    except AddonError as error:
        monitor.show_problem(told(error))


def _tell_error(error: EngineError) -> None:
    _tell(told(error.message), told(error.cure))


def _tell(error: str, cure: str) -> None:
    state = bpy.context.window_manager.robir
    state.error, state.error_cure = (_sentence(in_panel_words(text)) for text in (error, cure))
    state.engine_error = state.error


def _sentence(text: str) -> str:
    return text[:1].upper() + text[1:]


class ROBIR_OT_dismiss(Operator, bpy.types.Operator):
    """Put this notice away; nothing else changes."""

    bl_label = "Dismiss"
    bl_options = {"REGISTER"}
    needs = (unless(lambda c: has_notice(c.window_manager.robir), "There is no notice"),)

    def work(self, context: bpy.types.Context) -> None:
        """What was said is forgotten wherever an operator begins."""


class ROBIR_OT_allow_online(WaitingOperator, bpy.types.Operator):
    """Turn on Allow Online Access in Blender's preferences, which holds for all extensions, and
    install the engine.
    """

    bl_label = "Allow Online Access and Install"
    bl_options = {"REGISTER"}
    needs = (
        unless(
            lambda context: (
                not (bpy.app.online_access_override or context.preferences.system.use_online_access)
            ),
            "Online access is decided already",
        ),
    )

    def begin(self, context: bpy.types.Context, way: str) -> set[str]:
        context.preferences.system.use_online_access = True
        monitor.show_problem("")
        # a script installs by itself
        return bpy.ops.robir.install_engine(way) if way == "INVOKE_DEFAULT" else {"FINISHED"}


def has_notice(state: bpy.types.AnyType) -> bool:
    """Whether there is something to be said that the work at hand does not say itself."""
    return bool(state.error or (state.message and not state.task))


def is_offline(state: bpy.types.AnyType) -> bool:
    """Whether the notice is that the permission to go online is missing."""
    return state.error == told(OFFLINE)
