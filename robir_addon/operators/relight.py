# SPDX-License-Identifier: GPL-3.0-or-later
"""Another light on the imported object, the object in its photograph, and films."""

import math
from contextlib import suppress
from pathlib import Path
from typing import Any

import bpy
from bpy.props import StringProperty
from bpy_extras.io_utils import ImportHelper

from ..child import blender_command
from ..engine.errors import AddonError, RequestError, Sentence
from ..relighting.lights import choose_light, environment_file, shows_recovered_light, world_of
from ..result.compositing import clear_stage, set_stage
from ..result.importer import mark_of, read_cameras
from ..result.summary import read_shown
from ..words import told
from ..work import monitor
from .shared import Operator, is_imported, result_asset, result_paths, result_root, unless

_FILM_SAMPLES = 16  # Cycles samples a pixel of a film, before the noise is taken out


class ROBIR_OT_use_environment(Operator, bpy.types.Operator, ImportHelper):
    """Light the scene with a panorama of your own, .exr or .hdr."""

    bl_label = "Light from File"
    needs = (is_imported,)

    filter_glob: StringProperty(default="*.exr;*.hdr", options={"HIDDEN"})

    def work(self, context: bpy.types.Context) -> None:
        file = Path(bpy.path.abspath(self.filepath))
        if file.suffix.lower() not in (".exr", ".hdr"):
            if not file.name:
                raise RequestError("no file was given; choose .exr or .hdr")
            raise RequestError("{name} is no environment; choose .exr or .hdr", name=file.name)
        choose_light(context.scene, world_of(mark_of(result_root(context))), str(file))


class ROBIR_OT_into_photograph(Operator, bpy.types.Operator):
    """Look through the active camera of the photographs, or the scene's: photograph behind, a
    ground that catches the shadow, a transparent film for compositing. Press again to undo.
    """

    bl_label = "Put into Photograph"
    needs = (is_imported,)

    def work(self, context: bpy.types.Context) -> None:
        root = result_root(context)
        asset = result_asset(context)
        if not clear_stage(context.scene, mark_of(root)):
            set_stage(context, asset, read_cameras(result_paths(context)).get("ground"))


class _RenderingOperator(Operator):
    """Renders in a Blender of its own; with a window the panel shows how far it is."""

    bl_options = {"REGISTER"}
    needs = (
        is_imported,
        unless(lambda _: not monitor.is_busy(), "Something is at work: wait for it or cancel it"),
    )
    task: str
    """As `ROBIR_PG_state.task` has it."""

    cancelled: Sentence
    """Said where nothing came of it because the user stopped it."""

    def words(self, context: bpy.types.Context) -> list[str]:
        """The headless command."""
        raise NotImplementedError

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        try:
            command, environment = blender_command(self.words(context))
            made = _Made(self.cancelled, is_opened=self.task == "turntable")
            monitor.run_task(self.task, command, made.on_line, made.on_end, environment)
        except AddonError as error:
            return self.refuse(context, told(error))
        return {"FINISHED"}

    def work(self, context: bpy.types.Context) -> None:
        command, environment = blender_command(self.words(context))
        made = _Made(self.cancelled)
        monitor.wait_task(self.task, command, made.on_line, made.on_end, environment)
        if made.problem:
            raise AddonError(made.problem)
        self.report({"INFO"}, context.window_manager.robir.message)


class ROBIR_OT_turntable(_RenderingOperator, bpy.types.Operator):
    """Render a film of the light, the object or both going round once, in a Blender of its own, and
    open it; this one stays usable.
    """

    bl_label = "Render Turntable"

    task, cancelled = "turntable", Sentence("No film: it was cancelled")

    view: StringProperty(
        name="View",
        description="Camera of the film; empty takes the first held-out photograph",
        options={"SKIP_SAVE"},
    )

    def words(self, context: bpy.types.Context) -> list[str]:
        """The present light, turned as it is."""
        paths, settings = result_paths(context), context.scene.robir
        world = world_of(mark_of(paths.root))
        # the film turns the whole light as one image; of a sun lamp it knows nothing
        whole = shows_recovered_light(world)
        light = paths.environment if whole else environment_file(world)
        chosen = ["--views", self.view] if self.view else []
        return [
            *("relight", str(paths.root), "--environment", str(light), *chosen),
            *("--rotation", f"{math.degrees(settings.rotation):.6f}"),
            *("--turntable", str(settings.turntable_frames), "--turns", settings.turns),
            *("--side", str(settings.turntable_side), "--samples", str(_FILM_SAMPLES)),
        ]


class ROBIR_OT_picture_lights(_RenderingOperator, bpy.types.Operator):
    """Render a small picture of this object under each of the lights to choose from, in a Blender
    of its own; takes about half a minute, once.
    """

    bl_label = "Picture All Lights"

    task, cancelled = "lights", Sentence("No pictures: it was cancelled")

    def words(self, context: bpy.types.Context) -> list[str]:
        """All lights."""
        return ["lights", str(result_root(context))]


class _Made:
    """What comes of the process that renders: a file, or a problem in one sentence."""

    def __init__(self, cancelled: Sentence, *, is_opened: bool = False) -> None:
        self._cancelled, self._is_opened = cancelled, is_opened
        self.file: Path | None = None
        self.problem = ""

    def on_line(self, report: dict[str, Any]) -> None:
        """Remember the last file that was written."""
        if report.get("files"):
            self.file = Path(report["files"][-1])

    def on_end(self, code: int, said: str) -> None:
        """Say in the panel what there is, or why there is nothing."""
        state = bpy.context.window_manager.robir
        if code == 0 and self.file is not None:
            text = "{file} is in {folder}"
            state.message = told(text, file=self.file.name, folder=self.file.parent.name)
            read_shown()  # the panel may have new pictures
            if self._is_opened:
                with suppress(RuntimeError):  # nothing on this machine shows films
                    bpy.ops.wm.path_open(filepath=str(self.file))
        elif code == 130:
            state.message = told(self._cancelled)
        else:
            lines = said.splitlines() or [told("Blender ended with code {code}", code=code)]
            ours = [line for line in lines if line.startswith("error: ")]
            self.problem = (ours or lines)[-1].removeprefix("error: ")
            monitor.show_problem(self.problem)
