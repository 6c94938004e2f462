# SPDX-License-Identifier: GPL-3.0-or-later
"""Reconstruct the capture, or follow the run of it that is at work, and stop that."""

from dataclasses import replace
from pathlib import Path

import bpy

from ..capture import viewport
from ..capture.photographs import remember
from ..command_line import worker_environment
from ..engine.errors import AddonError, EngineError
from ..gateway import client
from ..preferences import engine_python
from ..result.delight import TARGET, mesh_file, target_of
from ..result.importer import mark_of
from ..result.known import check_spot
from ..words import reported, told
from ..work import monitor
from ..work.worker import absolute, in_panel_words, program, request_of, result_folder
from .capture import is_refused
from .shared import Operator, at_rest, has_capture, has_engine, in_object_mode, unless

_is_sound = unless(
    lambda context: not is_refused(absolute(context.scene.robir.capture)),
    "The capture has faults: mend what Check names and look again",
)
_has_target = unless(
    lambda c: c.object and c.object.type == "MESH" and c.object.select_get(),
    "Select the mesh object that the photographs show",
)
_is_at_work = unless(
    lambda c: monitor.is_busy() and c.window_manager.robir.task, "Nothing is at work"
)


class WorkerOperator(Operator):
    """Starts a worker on the chosen capture; what of it is asked, `request` says."""

    needs = (at_rest, has_capture, _is_sound, has_engine)

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        root = self._start(context)
        if root is None:
            return {"CANCELLED"}
        monitor.watch(root)
        return {"FINISHED"}

    def execute(self, context: bpy.types.Context) -> set[str]:
        root = self._start(context)
        if root is None:
            return {"CANCELLED"}
        snapshot = monitor.wait_job(root)
        for warning in snapshot.warnings:
            self.report({"WARNING"}, warning)
        sentence = in_panel_words(snapshot.message)
        if snapshot.state != "done":
            kind = "WARNING" if snapshot.state == "cancelled" else "ERROR"
            self.report({kind}, sentence)
            return {"CANCELLED"}
        problem = context.window_manager.robir.error
        if problem:  # it is done, but could not be imported
            self.report({"ERROR"}, problem)
            return {"CANCELLED"}
        self.report({"INFO"}, sentence)
        return {"FINISHED"}

    def _start(self, context: bpy.types.Context) -> Path | None:
        """Result folder of a worker that was started; None where it was not."""
        try:
            request = self.request(context)
            if not client.snapshot(request.out).is_live:
                check_spot(context.scene.robir, request)
                words = program(engine_python(context))
                client.start(words, request, worker_environment())
                own_folder = context.scene.robir.out and str(result_folder(context.scene.robir))
                remember(request.capture, own_folder)
        except (AddonError, EngineError, OSError, *client.START_ERRORS) as error:
            self.refuse(context, in_panel_words(told(error)))
            return None
        return request.out

    def request(self, context: bpy.types.Context) -> client.Request:
        """What to ask of the worker."""
        raise NotImplementedError


class ROBIR_OT_reconstruct(WorkerOperator, bpy.types.Operator):
    """Reconstruct the captured object and import it when it is done; an unfinished reconstruction
    is continued or, at work, followed; Blender may be closed meanwhile.
    """

    bl_label = "Reconstruct"

    def request(self, context: bpy.types.Context) -> client.Request:
        """The capture as it is chosen."""
        return request_of(context.scene.robir)


class ROBIR_OT_delight(WorkerOperator, bpy.types.Operator):
    """Make a material without shadows and highlights for the selected object, which stands where
    the capture's photographs show it, or anywhere if these have no cameras; its own material stays
    in its slot.
    """

    bl_label = "De-light Object"
    needs = (_has_target, in_object_mode, *WorkerOperator.needs)

    def request(self, context: bpy.types.Context) -> client.Request:
        """What to ask of the engine; the object is written beside the result."""
        settings, target = context.scene.robir, context.object
        result = result_folder(settings)
        assert result is not None
        file = mesh_file(target, settings, result)
        root = file.with_suffix("")
        target[TARGET] = mark_of(root)
        return replace(request_of(settings), out=root, mesh=file)


class ROBIR_OT_cancel_reconstruct(Operator, bpy.types.Operator):
    """Stop the work at hand; finished stages of a reconstruction are kept, and an installation
    goes on where it was stopped.
    """

    bl_label = "Cancel"
    bl_options = {"REGISTER"}
    needs = (_is_at_work,)

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        if event.type != "ESC":
            return self.execute(context)
        return context.window_manager.invoke_confirm(
            self,
            event,
            title="Stop the work at hand?",
            message="Finished stages of a reconstruction are kept.",
            confirm_text="Stop",
            icon="QUESTION",
        )

    def execute(self, context: bpy.types.Context) -> set[str]:
        monitor.cancel()
        return {"FINISHED"}


def _bring_in(root: Path) -> None:
    """Import a finished result as one step that can be undone."""
    with monitor.in_window():
        bpy.context.scene.robir.result = str(root)
        if not bpy.ops.robir.import_result.poll():
            monitor.show_problem(
                told(
                    "the reconstruction is done and can only be imported in Object Mode; leave "
                    "the present mode and press Import Result"
                )
            )
            return
        monitor.drop_steps()
        if target_of(root) is None:
            viewport.clear_capture()  # the result brings the same cameras
        try:
            bpy.ops.robir.import_result(directory=str(root))
        except RuntimeError as fault:  # how Blender passes on what that operator reported
            monitor.show_problem(reported(fault))
        bpy.ops.ed.undo_push(message="Import Result")


# A key and no modal operator: while one of those runs, Blender never saves automatically.
KEYS = (("3D View", "VIEW_3D", "ESC", ROBIR_OT_cancel_reconstruct, {}),)


def register() -> None:
    """Import what is done."""
    monitor.on_done.append(_bring_in)


def unregister() -> None:
    """Import no more."""
    monitor.on_done.remove(_bring_in)
