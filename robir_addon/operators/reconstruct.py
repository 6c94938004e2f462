# SPDX-License-Identifier: GPL-3.0-or-later
"""Reconstruct the capture, or follow the run of it that is at work, and stop that."""

from dataclasses import replace
from pathlib import Path

import bpy

from ..capture import viewport
from ..capture.recent import remember
from ..command_line import worker_environment
from ..engine import EngineError
from ..errors import AddonError
from ..gateway import client
from ..preferences import engine_python, engine_status
from ..result.delight import TARGET, mesh_file, target_of
from ..result.importer import mark_of
from ..words import reported, told
from ..work import monitor
from ..work.known import check_spot
from ..work.worker import absolute, in_panel_words, program, request_of, result_folder
from .capture import has_capture, is_refused, may_begin
from .shared import MixedIn, is_in_object_mode, refused

_keys: list[tuple[bpy.types.KeyMap, bpy.types.KeyMapItem]] = []


class WorkerOperator(MixedIn):
    """Starts a worker on the chosen capture; what of it is asked, `request` says."""

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """With a capture and an engine, while nothing is at work."""
        if not (may_begin(cls, context) and has_capture(cls, context)):
            return False
        if is_refused(absolute(context.scene.robir.capture)):
            cls.poll_message_set(
                told("The capture has faults: mend what Check names and look again")
            )
            return False
        status = engine_status(context)
        if status.state != "ready":
            cls.poll_message_set(f"{told(status.text)}: {told(status.cure)}")
            return False
        return True

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Start the worker and return; the object arrives by itself."""
        root = self._start(context)
        if root is None:
            return {"CANCELLED"}
        monitor.watch(root)
        return {"FINISHED"}

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Start the worker, wait for it, and import the object."""
        root = self._start(context)
        if root is None:
            return {"CANCELLED"}
        return _waited(self, context, root)

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
            monitor.show_problem(told(error))
            refused(self, context, in_panel_words(told(error)))
            return None
        return request.out

    def request(self, context: bpy.types.Context) -> client.Request:
        """What to ask of the worker.

        Raises:
            AddonError: With a sentence for the user.
        """
        raise NotImplementedError


class ROBIR_OT_reconstruct(WorkerOperator, bpy.types.Operator):
    """From the photographs to an object in the scene."""

    bl_idname = "robir.reconstruct"
    bl_label = "Reconstruct"
    bl_description = (
        "Reconstruct the captured object and import it when it is done; an unfinished "
        "reconstruction is continued or, at work, followed; Blender may be closed meanwhile"
    )
    bl_options = {"REGISTER", "UNDO"}

    def request(self, context: bpy.types.Context) -> client.Request:
        """The capture as it is chosen."""
        return request_of(context.scene.robir)


class ROBIR_OT_delight(WorkerOperator, bpy.types.Operator):
    """From photographs and the object they show to its texture without light."""

    bl_idname = "robir.delight"
    bl_label = "De-light Object"
    bl_description = (
        "Make a material without shadows and highlights for the selected object, which stands "
        "where the capture's photographs show it, or anywhere if these have no cameras; its own "
        "material stays in its slot"
    )
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """With a mesh object, a capture and an engine, while nothing is at work."""
        target = context.object
        if target is None or target.type != "MESH" or not target.select_get():
            cls.poll_message_set(told("Select the mesh object that the photographs show"))
            return False
        return is_in_object_mode(cls, context) and super().poll(context)

    def request(self, context: bpy.types.Context) -> client.Request:
        """What to ask of the engine; the object is written beside the result."""
        settings, target = context.scene.robir, context.object
        result = result_folder(settings)
        assert result is not None
        file = mesh_file(target, settings, result)
        root = file.with_suffix("")
        target[TARGET] = mark_of(root)
        return replace(request_of(settings), out=root, mesh=file)


class ROBIR_OT_cancel_reconstruct(bpy.types.Operator):
    """Stop what is at work."""

    bl_idname = "robir.cancel_reconstruct"
    bl_label = "Cancel"
    bl_description = "Stop the work at hand; finished stages of a reconstruction are kept"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """While something is at work."""
        if not (monitor.is_busy() and context.window_manager.robir.task):
            cls.poll_message_set(told("Nothing is at work"))
            return False
        return True

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Ask first where it was a key: Esc is pressed for many reasons."""
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
        """Ask it to stop; it is made to if it does not."""
        monitor.cancel()
        return {"FINISHED"}


def _waited(operator: bpy.types.Operator, context: bpy.types.Context, root: Path) -> set[str]:
    """Follow a job to its end and say how it ended."""
    snapshot = monitor.wait_job(root)
    for warning in snapshot.warnings:
        operator.report({"WARNING"}, warning)
    sentence = in_panel_words(snapshot.message)
    if snapshot.state != "done":
        kind = "WARNING" if snapshot.state == "cancelled" else "ERROR"
        operator.report({kind}, sentence)
        return {"CANCELLED"}
    problem = context.window_manager.robir.error
    if problem:  # it is done, but could not be imported
        operator.report({"ERROR"}, problem)
        return {"CANCELLED"}
    operator.report({"INFO"}, sentence)
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


def register() -> None:
    """Import what is done, and let Esc over the viewport stop what is at work."""
    monitor.on_done.append(_bring_in)
    keys = bpy.context.window_manager.keyconfigs.addon
    if keys is None:  # without a window
        return
    # A key and no modal operator: while one of those runs, Blender never saves automatically.
    keymap = keys.keymaps.new(name="3D View", space_type="VIEW_3D")
    item = keymap.keymap_items.new(ROBIR_OT_cancel_reconstruct.bl_idname, "ESC", "PRESS")
    _keys.append((keymap, item))


def unregister() -> None:
    """Take both back."""
    monitor.on_done.remove(_bring_in)
    while _keys:
        keymap, item = _keys.pop()
        keymap.keymap_items.remove(item)


CLASSES = (ROBIR_OT_reconstruct, ROBIR_OT_delight, ROBIR_OT_cancel_reconstruct)
