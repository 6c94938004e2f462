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
from ..engine import Sentence
from ..errors import AddonError, RequestError, ResultError
from ..relighting.lights import (
    choose_light,
    environment_file,
    shows_recovered_light,
    world_of,
)
from ..result.compositing import clear_stage, set_stage
from ..result.importer import asset_of, mark_of, read_cameras
from ..result.summary import read_shown
from ..words import told
from ..work import monitor
from .shared import ImportedOperator, result_paths, result_root

_FILM_SAMPLES = 16
"""Cycles samples a pixel of a film, before the noise is taken out."""


class ROBIR_OT_use_environment(ImportedOperator, bpy.types.Operator, ImportHelper):
    """Any lat-long image as the light."""

    bl_idname = "robir.use_environment"
    bl_label = "Environment File"
    bl_description = "Light the scene with a lat-long image, .exr or .hdr"
    bl_options = {"REGISTER", "UNDO"}

    filepath: StringProperty(
        name="File",
        description="Lat-long image",
        subtype="FILE_PATH",
        options={"HIDDEN", "SKIP_SAVE"},
    )
    filter_glob: StringProperty(default="*.exr;*.hdr", options={"HIDDEN"})

    def work(self, context: bpy.types.Context) -> None:
        """Take the chosen file."""
        file = Path(bpy.path.abspath(self.filepath))
        if file.suffix.lower() not in (".exr", ".hdr"):
            if not file.name:
                raise RequestError("no file was given; choose .exr or .hdr")
            raise RequestError("{name} is no environment; choose .exr or .hdr", name=file.name)
        choose_light(context.scene, world_of(mark_of(result_root(context))), str(file))


class ROBIR_OT_into_photograph(ImportedOperator, bpy.types.Operator):
    """The object in its photograph: shadow on the ground, photograph behind."""

    bl_idname = "robir.into_photograph"
    bl_label = "Put into Photograph"
    bl_description = (
        "Look through the active camera of the photographs, or the scene's: photograph behind, a "
        "ground that catches the shadow, a transparent film for compositing. Press again to undo"
    )
    bl_options = {"REGISTER", "UNDO"}

    def work(self, context: bpy.types.Context) -> None:
        """Set it up, or take it away."""
        root = result_root(context)
        asset = asset_of(root)
        if asset is None:
            raise ResultError("the object is not in this file; import the result again")
        if not clear_stage(context.scene, mark_of(root)):
            set_stage(context, asset, read_cameras(result_paths(context)).get("ground"))


class _RenderingOperator(ImportedOperator):
    """Renders in a Blender of its own; with a window the panel shows how far it is."""

    task: str
    """As `ROBIR_PG_state.task` has it."""

    cancelled: Sentence
    """Said where nothing came of it because the user stopped it."""

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """While no other work goes on."""
        if not super().poll(context):
            return False
        if monitor.is_busy():
            cls.poll_message_set(told("Something is at work: wait for it or cancel it"))
            return False
        return True

    def words(self, context: bpy.types.Context) -> list[str]:
        """The headless command."""
        raise NotImplementedError

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Start rendering and return; the panel shows how far it is."""
        try:
            command, environment = blender_command(self.words(context))
            made = _Made(self.cancelled, is_opened=self.task == "turntable")
            monitor.run_task(self.task, command, made.on_line, made.on_end, environment)
        except AddonError as error:
            return self.refuse(context, told(error))
        return {"FINISHED"}

    def work(self, context: bpy.types.Context) -> None:
        """Render and wait for it."""
        command, environment = blender_command(self.words(context))
        made = _Made(self.cancelled)
        monitor.wait_task(self.task, command, made.on_line, made.on_end, environment)
        if made.problem:
            raise AddonError(made.problem)
        self.report({"INFO"}, context.window_manager.robir.message)


class ROBIR_OT_turntable(_RenderingOperator, bpy.types.Operator):
    """A film of the light or the object going round once."""

    bl_idname = "robir.turntable"
    bl_label = "Render Turntable"
    bl_description = (
        "Render a film of the light, the object or both going round once, "
        "in a Blender of its own, and open it; this one stays usable"
    )
    bl_options = {"REGISTER"}

    task, cancelled = "turntable", Sentence("No film: it was cancelled")

    view: StringProperty(
        name="View",
        description="Camera of the film; empty takes the first photograph kept aside",
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
    """This object under every light, to choose by."""

    bl_idname = "robir.picture_lights"
    bl_label = "Picture All Lights"
    bl_description = (
        "Render a small picture of this object under each of the lights to choose from, "
        "in a Blender of its own; takes about half a minute, once"
    )
    bl_options = {"REGISTER"}

    task, cancelled = "lights", Sentence("No pictures: it was cancelled")

    def words(self, context: bpy.types.Context) -> list[str]:
        """All lights."""
        return ["lights", str(result_root(context))]


class _Made:
    """What comes of the process that renders.

    Args:
        cancelled: What to say where the user stopped it.
        is_opened: Whether to open the file when it is there.

    Attributes:
        file: The last file that was written; None until it is there.
        problem: One sentence if there is none.
    """

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


CLASSES = (
    ROBIR_OT_use_environment,
    ROBIR_OT_into_photograph,
    ROBIR_OT_turntable,
    ROBIR_OT_picture_lights,
)
