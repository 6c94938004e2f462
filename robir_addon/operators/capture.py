# SPDX-License-Identifier: GPL-3.0-or-later
"""Choose a capture, look at it, leave photographs out, and put it away again."""

from pathlib import Path
from typing import Any

import bpy
from bpy.props import BoolProperty, IntProperty

from ..blocks import select_alone
from ..capture import viewport
from ..capture.photographs import list_photographs, result_of
from ..capture.viewport import bring_back
from ..engine.errors import AddonError, EngineError
from ..gateway import client
from ..preferences import engine_python
from ..words import told
from ..work import monitor
from ..work.worker import absolute, in_panel_words, program, request_of, result_folder
from .shared import (
    Operator,
    WaitingOperator,
    at_rest,
    folder_property,
    has_capture,
    is_engine_coming,
    may_choose,
    unless,
)

_MOST_NAMES = 3  # files that a finding names in the panel; `robir check` names more
# settings that say what the user knows of the capture
_KNOWN = ("spot_texel", "spot_albedo", "spot_result", "spot_shape", "sun", "tone_curve")
_PLACE = ("view_scale", "view_shift")  # settings that say how the capture was brought into view
_faulty: set[Path | None] = set()  # captures that the last look at them refused


def is_refused(capture: Path | None) -> bool:
    """Whether the last look at a capture found faults that have to be mended first."""
    return capture in _faulty


class _Look:
    """One look at a capture: what the engine says of it becomes the panel's and the viewport's."""

    def __init__(self, scene: bpy.types.Scene) -> None:
        self._scene = scene.name
        self._capture = absolute(scene.robir.capture)
        self._facts: dict[str, Any] | None = None
        self.problem = ""

    def end_clicked(self, code: int, said: str) -> None:
        """Show the answer as one step that can be undone."""
        self.end(code, said)
        with monitor.in_window():
            bpy.ops.ed.undo_push(message=ROBIR_OT_look_at_capture.bl_label)

    def end_chosen(self, code: int, said: str) -> None:
        """Show the answer; follow a run of this capture: a closed Blender left no other trace."""
        self.end_clicked(code, said)
        scene = bpy.data.scenes.get(self._scene)
        if scene is None or absolute(scene.robir.capture) != self._capture:
            return
        root = result_folder(scene.robir)
        if root is None:
            return
        known = client.snapshot(root)
        if known.is_live or (known.state == "done" and absolute(scene.robir.result) != root):
            monitor.watch(root)

    def take(self, event: dict[str, Any]) -> None:
        """Remember the answer among what the engine prints."""
        if "accepted" in event:
            self._facts = event

    def end(self, code: int, said: str) -> None:
        """Show the answer; `problem` says why the capture cannot be used, if so."""
        scene = bpy.data.scenes.get(self._scene)
        if scene is None or absolute(scene.robir.capture) != self._capture:
            return  # another file or another capture by now
        state = bpy.context.window_manager.robir
        _forget(state)
        if self._facts is None:
            if code == 130:
                self.problem = told("The look at the capture was stopped")
                state.message = self.problem
            else:
                last = (said.splitlines() or [told("it ended with code {code}", code=code)])[-1]
                text = "the engine could not look at the capture ({said}); check the engine"
                self.problem = told(text, said=last)
                monitor.show_problem(self.problem)
            return
        state.looked_at = scene.robir.capture
        _show_findings(state, self._facts["findings"])
        views = [view["name"] for view in self._facts.get("cameras", ())]
        list_photographs(scene.robir, views, self._facts["findings"])
        if not self._facts["accepted"]:
            _faulty.add(self._capture)
            first = state.findings[0]
            self.problem = f"{first.text}; {first.cure}" if first.cure else first.text
            if "cameras" not in self._facts:
                viewport.clear_capture()
                return
        else:
            count = self._facts["views"] + self._facts["held_out"]
            text = "{count} photographs with cameras ({name})"
            state.recognised = told(text, name=self._facts["format"], count=count)
        try:
            monitor.do_in_steps(viewport.show_capture(scene, self._facts))
        except RuntimeError as fault:
            text = "a photograph cannot be shown ({fault}); look again"
            self.problem = told(text, fault=str(fault).strip())
            monitor.show_problem(self.problem)


def _forget(state: Any) -> None:
    """What was known of the capture before."""
    state.recognised = state.looked_at = ""
    state.findings.clear()
    _faulty.clear()
    monitor.drop_steps()


def _show_findings(state: Any, findings: list[dict[str, Any]]) -> None:
    for finding in findings:
        shown = state.findings.add()
        shown.level = finding["level"]
        shown.text = in_panel_words(finding["message"]) + _named(finding["files"])
        shown.cure = in_panel_words(finding["cure"])
        shown.code, shown.files = finding["code"], "\n".join(finding["files"])


def _named(files: list[str]) -> str:
    """The first of the files concerned, in brackets."""
    if not files:
        return ""
    names, more = ", ".join(files[:_MOST_NAMES]), len(files) - _MOST_NAMES
    if more > 0:
        names = told("{names} and {count} more", names=names, count=more)
    return f" ({names})"


class ROBIR_OT_choose_capture(WaitingOperator, bpy.types.Operator):
    """Choose the folder that holds the photographs and their cameras."""

    bl_label = "Choose Capture"
    needs = (may_choose,)

    directory: folder_property("Capture", "Folder with the photographs and their cameras")
    filter_folder: BoolProperty(default=True, options={"HIDDEN"})

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        if self.directory:
            return super().invoke(context, event)
        self.directory = context.scene.robir.capture
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}

    def begin(self, context: bpy.types.Context, way: str) -> set[str]:
        capture = absolute(self.directory)
        if capture is None or not capture.exists():
            text = "There is no folder {name!r}; choose another"
            self.report({"ERROR"}, told(text, name=self.directory))
            return {"CANCELLED"}
        return take_capture(context, capture, way)


class ROBIR_OT_look_at_capture(Operator, bpy.types.Operator):
    """Recognise the capture, check it, and show its cameras in the viewport."""

    bl_label = "Look at Capture"
    needs = (has_capture, at_rest)

    is_chosen: BoolProperty(
        name="Just chosen",
        description="Look for a run of the capture as well",
        options={"HIDDEN", "SKIP_SAVE"},
    )

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        look = _Look(context.scene)
        end = look.end_chosen if self.is_chosen else look.end_clicked
        return self._look(context, monitor.run_task, look, end)

    def execute(self, context: bpy.types.Context) -> set[str]:
        look = _Look(context.scene)
        answer = self._look(context, monitor.wait_task, look, look.end)
        if look.problem:
            self.report({"ERROR"}, look.problem)
            return {"CANCELLED"}
        return answer

    def _look(self, context: bpy.types.Context, run: Any, look: _Look, end: Any) -> set[str]:
        request = request_of(context.scene.robir)
        words = ["check", str(request.capture), "--json", *request.choice_words()]
        if request.masks is not None:
            words += ["--masks", str(request.masks)]
        try:
            run("look", [*program(engine_python(context)), *words], look.take, end)
        except (AddonError, EngineError) as error:
            return self.refuse(context, told(error))
        if monitor.is_busy():
            context.window_manager.robir.message = told("Reading the photographs")
        return {"FINISHED"}


class ROBIR_OT_add_box(Operator, bpy.types.Operator):
    """Add a box to move and scale about the object, which tells it from its surroundings where the
    capture has no masks; then look at the capture again.
    """

    bl_label = "Add Object Box"
    needs = (has_capture,)

    def work(self, context: bpy.types.Context) -> None:
        box = viewport.add_box(context.scene)
        context.scene.robir.box = box
        select_alone(context.view_layer, box)


class ROBIR_OT_clear_capture(Operator, bpy.types.Operator):
    """Take the capture's cameras and photographs out of the scene; no file is lost."""

    bl_label = "Clear Capture"
    needs = (at_rest,)

    def work(self, context: bpy.types.Context) -> None:
        viewport.clear_capture()
        if not context.scene.robir.result:
            bring_back(context.scene, context.view_layer)
        _forget(context.window_manager.robir)
        _forget_choices(context.scene.robir)
        context.scene.robir.capture = ""


def take_capture(context: bpy.types.Context, capture: Path, way: str) -> set[str]:
    """Make a folder the scene's capture and look at it; what an operator then returns."""
    if absolute(context.scene.robir.capture) != capture:
        _forget_choices(context.scene.robir)
        context.scene.robir.out = result_of(capture)
    context.scene.robir.capture = str(capture)
    if is_engine_coming(context):
        return {"FINISHED"}  # it is looked at when the engine is there
    return bpy.ops.robir.look_at_capture(way, is_chosen=True)


def _forget_choices(settings: Any) -> None:
    """What was chosen for one capture is no other's."""
    own = ("masks", "box", "photographs", "skip_missing", "out", "result")
    for name in (*own, *_PLACE, *_KNOWN):
        settings.property_unset(name)


def look_at_waiting(context: bpy.types.Context) -> None:
    """Look at the capture that was chosen before there was an engine."""
    state = context.window_manager.robir
    if state.looked_at != context.scene.robir.capture and not bpy.app.background:
        with monitor.in_window():
            bpy.ops.robir.look_at_capture("INVOKE_DEFAULT", is_chosen=True)


MISSING = "missing-images"  # code of the finding that poses have no photograph


_has_findings = unless(lambda c: c.window_manager.robir.findings, "Look at the capture first")


class ROBIR_OT_leave_out(WaitingOperator, bpy.types.Operator):
    """Do without the photographs that this finding names, and look at the capture again; the list
    of photographs takes them back.
    """

    bl_label = "Leave Out"
    needs = (has_capture, at_rest, _has_findings)

    finding: IntProperty(
        name="Finding", description="Its place in the list of findings", options={"SKIP_SAVE"}
    )

    def begin(self, context: bpy.types.Context, way: str) -> set[str]:
        settings = context.scene.robir
        findings = context.window_manager.robir.findings
        finding = findings[min(self.finding, len(findings) - 1)]
        if finding.code == MISSING:
            settings.skip_missing = True
        for name in finding.files.splitlines():
            photograph = settings.photographs.get(name)
            if photograph is not None:
                photograph.is_used = False
        return bpy.ops.robir.look_at_capture(way)


def can_leave_out(finding: bpy.types.AnyType, settings: bpy.types.AnyType) -> bool:
    """Whether a finding names photographs that the capture may do without."""
    names = finding.files.splitlines()
    known = settings.photographs
    return finding.code == MISSING or any(n in known and known[n].is_used for n in names)
