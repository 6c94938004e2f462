# SPDX-License-Identifier: GPL-3.0-or-later
"""The recovered light or another on the imported object, and a film of the light turning."""

import math
from pathlib import Path
from typing import Any

import bpy
from bpy.props import EnumProperty, StringProperty
from bpy_extras.io_utils import ImportHelper

from ..engine import Sentence
from ..errors import AddonError, RequestError
from ..relighting.lights import (
    STUDIO_LIGHTS,
    environment_file,
    show_environment,
    show_recovered_light,
    shows_recovered_light,
    turn_light,
    world_of,
)
from ..result.importer import mark_of
from ..result.summary import read_shown
from ..words import told
from ..work import monitor
from ..work.child import blender_command
from .shared import ImportedOperator, result_paths, result_root


class ROBIR_OT_use_recovered_light(ImportedOperator, bpy.types.Operator):
    """The light of the photographs."""

    bl_idname = "robir.use_recovered_light"
    bl_label = "Recovered Light"
    bl_description = "Light the scene as the photographs were, not turned"
    bl_options = {"REGISTER", "UNDO"}

    def work(self, context: bpy.types.Context) -> None:
        """Show the World's own light, and the suns as the settings say."""
        settings = context.scene.robir
        world = world_of(mark_of(result_root(context)))
        show_recovered_light(context.scene, world, settings.use_sun_lamp)
        settings.rotation = 0.0
        turn_light(context.scene, 0.0)


class _OtherLight(ImportedOperator):
    def light_with(self, context: bpy.types.Context, file: Path) -> None:
        """Show another environment, turned as the settings say; the Sun lamps are hidden."""
        world = world_of(mark_of(result_root(context)))
        show_environment(context.scene, world, file)
        turn_light(context.scene, context.scene.robir.rotation)


class ROBIR_OT_use_environment(_OtherLight, bpy.types.Operator, ImportHelper):
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
        self.light_with(context, file)


class ROBIR_OT_use_studio_light(_OtherLight, bpy.types.Operator):
    """A light that Blender ships."""

    bl_idname = "robir.use_studio_light"
    bl_label = "Studio Light"
    bl_description = "Light the scene with an environment that Blender ships"
    bl_options = {"REGISTER", "UNDO"}

    light: EnumProperty(
        name="Light", description="Which one", items=STUDIO_LIGHTS, default="studio"
    )

    def work(self, context: bpy.types.Context) -> None:
        """Take the file that came with Blender."""
        folder = bpy.utils.system_resource("DATAFILES", path="studiolights/world")
        self.light_with(context, Path(folder) / f"{self.light}.exr")
        context.scene.robir.studio_light = self.light


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
            made = _Made(self.cancelled)
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
    """A film of the light going round the object once."""

    bl_idname = "robir.turntable"
    bl_label = "Render Turntable"
    bl_description = (
        "Render a film of the present light going round the object once, "
        "in a Blender of its own; this one stays usable"
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
            *("--turntable", str(settings.turntable_frames)),
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

    Attributes:
        file: The last file that was written; None until it is there.
        problem: One sentence if there is none.
    """

    def __init__(self, cancelled: Sentence) -> None:
        self._cancelled = cancelled
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
        elif code == 130:
            state.message = told(self._cancelled)
        else:
            lines = said.splitlines() or [told("Blender ended with code {code}", code=code)]
            ours = [line for line in lines if line.startswith("error: ")]
            self.problem = (ours or lines)[-1].removeprefix("error: ")
            monitor.show_problem(self.problem)


CLASSES = (
    ROBIR_OT_use_recovered_light,
    ROBIR_OT_use_environment,
    ROBIR_OT_use_studio_light,
    ROBIR_OT_turntable,
    ROBIR_OT_picture_lights,
)
