# SPDX-License-Identifier: GPL-3.0-or-later
"""Many captures into a library of assets, and that library into Blender's Preferences."""

from collections.abc import Callable
from pathlib import Path

import bpy
from bpy.props import StringProperty

from ..command_line import worker_environment
from ..engine.errors import RequestError
from ..gateway import holder, library
from ..preferences import engine_python
from ..words import told
from ..work import batch
from ..work.worker import program
from .shared import Operator, folder_property, has_engine, unless

_has_library = unless(
    lambda context: context.scene.robir.library, "Choose a library, or reconstruct a folder first"
)


class ROBIR_OT_run_batch(Operator, bpy.types.Operator):
    """Reconstruct every capture in a folder, each to an asset of the library; what is done already
    is left alone, and Blender may be closed meanwhile.
    """

    bl_label = "Reconstruct a Folder"
    bl_options = {"REGISTER"}
    needs = (has_engine,)

    directory: folder_property(
        "Captures", "Folder of captures; empty goes on with the library's own"
    )

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        paths = batch.library_paths(context.scene.robir)
        if paths is not None and paths.plan.is_file():
            return self.execute(context)
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}

    def work(self, context: bpy.types.Context) -> None:
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
            text = "a batch is at work on {name} already (process {pid})"
            raise RequestError(text, name=paths.root.name, pid=pid)
        words = program(engine_python(context))
        try:
            library.start_batch(words, sources, paths, worker_environment())
        except ValueError as fault:
            raise RequestError(str(fault)) from fault
        batch.follow()


class ROBIR_OT_stop_batch(Operator, bpy.types.Operator):
    """End what is at work; Reconstruct a Folder goes on from the finished stages."""

    bl_label = "Pause"
    bl_options = {"REGISTER"}
    needs = (_has_library,)

    def work(self, context: bpy.types.Context) -> None:
        library.stop_batch(batch.chosen(context.scene.robir))
        batch.look()


class _CaptureOperator(Operator):
    """Changes what becomes of one capture in the queue."""

    bl_options = {"REGISTER", "INTERNAL"}
    needs = (_has_library,)
    change: Callable[[library.LibraryPaths, str], None]

    name: StringProperty(name="Capture", options={"HIDDEN", "SKIP_SAVE"})

    def work(self, context: bpy.types.Context) -> None:
        try:
            self.change(batch.chosen(context.scene.robir), self.name)
        except ValueError as fault:
            raise RequestError(str(fault)) from fault
        batch.look()


class ROBIR_OT_drop_from_batch(_CaptureOperator, bpy.types.Operator):
    """Leave this capture out of the batch; what it has finished is kept."""

    bl_label = "Drop from Batch"
    change = staticmethod(library.drop)


class ROBIR_OT_prefer_in_batch(_CaptureOperator, bpy.types.Operator):
    """Let the batch do this capture before all others that wait."""

    bl_label = "Do Next"
    change = staticmethod(library.prefer)


class ROBIR_OT_add_library(Operator, bpy.types.Operator):
    """Show the library's assets in the asset browser of every file."""

    bl_label = "Show in Asset Browser"
    bl_options = {"REGISTER"}
    needs = (_has_library,)

    def work(self, context: bpy.types.Context) -> None:
        root = batch.chosen(context.scene.robir).root
        if not root.is_dir():
            raise RequestError("{folder} is no folder; reconstruct a folder first", folder=root)
        libraries = context.preferences.filepaths.asset_libraries
        if any(Path(known.path) == root for known in libraries):
            self.report({"INFO"}, told("{name} is in the Preferences already", name=root.name))
            return
        libraries.new(name=root.name, directory=str(root))
        context.preferences.is_dirty = True
        self.report({"INFO"}, told("The asset browser shows {name} now", name=root.name))
