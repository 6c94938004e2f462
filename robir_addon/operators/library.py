# SPDX-License-Identifier: GPL-3.0-or-later
"""Many captures into a library of assets, and that library into Blender's Preferences."""

from pathlib import Path

import bpy
from bpy.props import StringProperty

from ..command_line import worker_environment
from ..engine import EngineError
from ..errors import RequestError
from ..gateway import holder, library
from ..preferences import engine_python, engine_status
from ..words import told
from ..work import batch
from ..work.worker import program
from .shared import ResultOperator


class _LibraryOperator(ResultOperator):
    """Works on the chosen library."""

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Once a library is chosen."""
        if not context.scene.robir.library:
            cls.poll_message_set(told("Choose a library, or run a batch first"))
            return False
        return True


class ROBIR_OT_run_batch(ResultOperator, bpy.types.Operator):
    """Every capture of a folder, each to an asset of the library."""

    bl_idname = "robir.run_batch"
    bl_label = "Run Batch"
    bl_description = (
        "Reconstruct every capture in a folder, each to an asset of the library; "
        "what is done already is left alone, and Blender may be closed meanwhile"
    )
    bl_options = {"REGISTER"}

    directory: StringProperty(
        name="Captures",
        description="Folder of captures; empty goes on with the library's own",
        subtype="DIR_PATH",
        options={"HIDDEN", "SKIP_SAVE"},
    )

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """With an engine."""
        status = engine_status(context)
        if status.state != "ready":
            cls.poll_message_set(f"{told(status.text)}: {told(status.cure)}")
            return False
        return True

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Go on with an unfinished library, else ask for the folder of captures."""
        paths = batch.library_paths(context.scene.robir)
        if paths is not None and paths.plan.is_file():
            return self.execute(context)
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}

    def work(self, context: bpy.types.Context) -> None:
        """Start it and return."""
        settings = context.scene.robir
        sources = []
        if self.directory:
            captures = Path(bpy.path.abspath(self.directory)).absolute()
            sources = [str(captures / "*")]
            if not settings.library:
                settings.library = str(captures.with_name(f"{captures.name}_library"))
        paths = batch.library_paths(settings)
        if paths is None:
            raise RequestError("no folder of captures was given; choose one")
        pid = holder(paths.lock)
        if pid is not None:
            raise RequestError(
                "a batch is at work on {name} already (process {pid})",
                name=paths.root.name,
                pid=pid,
            )
        try:
            words = program(engine_python(context))
        except EngineError as error:
            raise RequestError(told(error)) from error
        try:
            library.start_batch(words, sources, paths, worker_environment())
        except ValueError as fault:
            raise RequestError(str(fault)) from fault
        batch.follow()


class ROBIR_OT_stop_batch(_LibraryOperator, bpy.types.Operator):
    """End the batch in good order; it can go on later."""

    bl_idname = "robir.stop_batch"
    bl_label = "Pause Batch"
    bl_description = "End what the batch has at work; Run Batch goes on from the finished stages"
    bl_options = {"REGISTER"}

    def work(self, context: bpy.types.Context) -> None:
        """Ask it to end."""
        library.stop_batch(batch.chosen(context.scene.robir))
        batch.look()


class ROBIR_OT_drop_from_batch(_LibraryOperator, bpy.types.Operator):
    """Leave one capture out."""

    bl_idname = "robir.drop_from_batch"
    bl_label = "Drop from Batch"
    bl_description = "Leave this capture out of the batch; what it has finished is kept"
    bl_options = {"REGISTER", "INTERNAL"}

    name: StringProperty(name="Capture", options={"HIDDEN", "SKIP_SAVE"})

    def work(self, context: bpy.types.Context) -> None:
        """Note it for the batch."""
        try:
            library.drop(batch.chosen(context.scene.robir), self.name)
        except ValueError as fault:
            raise RequestError(str(fault)) from fault
        batch.look()


class ROBIR_OT_prefer_in_batch(_LibraryOperator, bpy.types.Operator):
    """Do one capture before the others."""

    bl_idname = "robir.prefer_in_batch"
    bl_label = "Do Next"
    bl_description = "Let the batch do this capture before all others that wait"
    bl_options = {"REGISTER", "INTERNAL"}

    name: StringProperty(name="Capture", options={"HIDDEN", "SKIP_SAVE"})

    def work(self, context: bpy.types.Context) -> None:
        """Note it for the batch."""
        try:
            library.prefer(batch.chosen(context.scene.robir), self.name)
        except ValueError as fault:
            raise RequestError(str(fault)) from fault
        batch.look()


class ROBIR_OT_add_library(_LibraryOperator, bpy.types.Operator):
    """The library in Blender's asset browser."""

    bl_idname = "robir.add_library"
    bl_label = "Add to Preferences"
    bl_description = "Show the library's assets in the asset browser of every file"
    bl_options = {"REGISTER"}

    def work(self, context: bpy.types.Context) -> None:
        """Register the folder, once."""
        root = batch.chosen(context.scene.robir).root
        if not root.is_dir():
            raise RequestError("{folder} is no folder; run a batch first", folder=root)
        libraries = context.preferences.filepaths.asset_libraries
        if any(Path(known.path) == root for known in libraries):
            self.report({"INFO"}, told("{name} is in the Preferences already", name=root.name))
            return
        libraries.new(name=root.name, directory=str(root))
        context.preferences.is_dirty = True
        self.report({"INFO"}, told("The asset browser shows {name} now", name=root.name))


CLASSES = (
    ROBIR_OT_run_batch,
    ROBIR_OT_stop_batch,
    ROBIR_OT_drop_from_batch,
    ROBIR_OT_prefer_in_batch,
    ROBIR_OT_add_library,
)
