# SPDX-License-Identifier: GPL-3.0-or-later
"""Bring a result into the file, and look at it beside what went in."""

from pathlib import Path

import bpy
from bpy.props import StringProperty

from ..blocks import MARK
from ..capture.startup import bring_back
from ..errors import ResultError
from ..relighting.view_transform import match_view_transform
from ..result.arrival import bring_in
from ..result.delight import give_back, target_of
from ..result.importer import asset_of, read_tone_curve, remove_result
from ..result.materials import is_edited
from ..words import told
from ..work.known import forget_former_spot
from ..work.support import support_report
from .shared import ImportedOperator, ResultOperator, is_in_object_mode, result_paths, result_root


class ROBIR_OT_import_result(ResultOperator, bpy.types.Operator):
    """Object, light and cameras of a result folder into the scene."""

    bl_idname = "robir.import_result"
    bl_label = "Import Result"
    bl_description = (
        "Bring a finished result into the scene; importing it again replaces mesh and textures, "
        "and keeps place, modifiers, materials and light"
    )
    bl_options = {"REGISTER", "UNDO"}

    directory: StringProperty(
        name="Result",
        description="Result folder; empty takes the one that is shown",
        subtype="DIR_PATH",
        options={"HIDDEN", "SKIP_SAVE"},
    )

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Always but in edit mode, where objects cannot be replaced."""
        return is_in_object_mode(cls, context)

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Ask for the folder, beginning with the one that is shown."""
        if not self.directory:
            self.directory = context.scene.robir.result
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}

    def work(self, context: bpy.types.Context) -> None:
        """Import, select and show the object."""
        folder = self.directory or context.scene.robir.result
        if not folder:
            raise ResultError("no folder was given; choose one that `robir reconstruct` finished")
        root = Path(bpy.path.abspath(folder)).absolute()
        if _is_edited(root):
            raise ResultError(
                "the object's mesh was edited and would be lost; press Refresh Result to have it "
                "replaced"
            )
        _bring_in(self, context, root)


class ROBIR_OT_refresh_result(ImportedOperator, bpy.types.Operator):
    """What the result folder holds now, on the object as the user has it."""

    bl_idname = "robir.refresh_result"
    bl_label = "Refresh Result"
    bl_description = (
        "Read mesh and textures anew; place, modifiers, materials and light stay as you made them"
    )
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Where a result is in the file, but not in edit mode."""
        return super().poll(context) and is_in_object_mode(cls, context)

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Ask first where the user has changed the mesh."""
        if not _is_edited(result_root(context)):
            return self.execute(context)
        return context.window_manager.invoke_confirm(
            self,
            event,
            title="Replace the edited mesh?",
            message="You have changed this object's mesh; the newer one takes its place.",
            confirm_text="Replace",
            icon="WARNING",
        )

    def work(self, context: bpy.types.Context) -> None:
        """Replace, edited or not."""
        _bring_in(self, context, result_root(context))


def _is_edited(root: Path) -> bool:
    asset = asset_of(root)
    return asset is not None and is_edited(asset)


def _bring_in(operator: bpy.types.Operator, context: bpy.types.Context, root: Path) -> None:
    notes = (bring_in if target_of(root) is None else give_back)(context, root)
    notes += forget_former_spot(context.scene.robir, root)
    for note in notes:
        operator.report({"INFO"}, note)
    context.window_manager.robir.message = ". ".join(notes)


class ROBIR_OT_remove_result(ImportedOperator, bpy.types.Operator):
    """Take a result out again."""

    bl_idname = "robir.remove_result"
    bl_label = "Remove Result"
    bl_description = (
        "Take the object, its light and its cameras out of the file and give the scene its own "
        "World back; the result folder stays"
    )
    bl_options = {"REGISTER", "UNDO"}

    def work(self, context: bpy.types.Context) -> None:
        """Remove it and show another one of the file, if there is any."""
        remove_result(result_root(context))
        left = next((o for o in context.scene.objects if o.type == "MESH" and MARK in o), None)
        context.scene.robir.result = left[MARK] if left else ""
        if left:
            left.select_set(True)
            context.view_layer.objects.active = left
        else:
            bring_back(context.scene, context.view_layer)


class ROBIR_OT_match_view_transform(ResultOperator, bpy.types.Operator):
    """The photographs' tone curve as the scene's view transform."""

    bl_idname = "robir.match_view_transform"
    bl_label = "Match View Transform"
    bl_description = "Show the scene through the tone curve that was recovered, as the photographs"
    bl_options = {"REGISTER", "UNDO"}

    def work(self, context: bpy.types.Context) -> None:
        """Set the scene's colour management."""
        curve = read_tone_curve(result_paths(context))
        for note in match_view_transform(context.scene, curve):
            self.report({"WARNING"}, told(note))


class ROBIR_OT_open_report(ResultOperator, bpy.types.Operator):
    """The result's report in the web browser."""

    bl_idname = "robir.open_report"
    bl_label = "Open Report"
    bl_description = "Open the result's report, a file of your own, in the web browser"

    def work(self, context: bpy.types.Context) -> None:
        """Hand the local file to the browser; without a window its path is said."""
        report = result_paths(context).report
        if not report.is_file():
            raise ResultError("{file} is missing; export the result again", file=report.name)
        if bpy.app.background:
            self.report({"INFO"}, str(report))
        else:
            bpy.ops.wm.url_open(url=report.as_uri())


class ROBIR_OT_copy_report(bpy.types.Operator):
    """What helps whoever is asked for help, on the clipboard."""

    bl_idname = "robir.copy_report"
    bl_label = "Copy Report"
    bl_description = (
        "Copy versions, settings and the end of the log for a request for help; "
        "it holds no path of yours and not your name"
    )

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Fill the clipboard."""
        context.window_manager.clipboard = support_report(context)
        self.report({"INFO"}, told("The report is on the clipboard"))
        return {"FINISHED"}


CLASSES = (
    ROBIR_OT_import_result,
    ROBIR_OT_refresh_result,
    ROBIR_OT_remove_result,
    ROBIR_OT_match_view_transform,
    ROBIR_OT_open_report,
    ROBIR_OT_copy_report,
)
