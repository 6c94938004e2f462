# SPDX-License-Identifier: GPL-3.0-or-later
"""Bring a result into the file, and look at it beside what went in."""

from pathlib import Path
from typing import Any

import bpy
from bpy.props import IntProperty, StringProperty

from ..blocks import MARK
from ..capture.cameras import VIEW
from ..capture.startup import bring_back
from ..errors import ResultError
from ..gateway import JobPaths
from ..relighting.view_transform import match_view_transform
from ..result.arrival import bring_in
from ..result.captions import CAPTIONS
from ..result.comparison import compare, neighbour
from ..result.delight import give_back, target_of
from ..result.importer import asset_of, mark_of, read_cameras, read_tone_curve, remove_result
from ..result.materials import is_edited
from ..result.pictures import put_image, show_image
from ..words import told, words
from ..work.known import forget_former_spot
from ..work.support import support_report
from .shared import ImportedOperator, ResultOperator, is_in_object_mode, result_paths, result_root

COMPARISON = "RobIR comparison"


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
        bring_back(context.scene, context.view_layer)
        left = (o.get(MARK) for o in context.scene.objects if o.type == "MESH")
        context.scene.robir.result = next(filter(None, left), "")


class ROBIR_OT_compare(ResultOperator, bpy.types.Operator):
    """Photograph, re-render, albedo and roughness side by side."""

    bl_idname = "robir.compare"
    bl_label = "Compare"
    bl_description = "Show a photograph, its re-render, albedo and roughness side by side"
    bl_options = {"REGISTER", "UNDO"}

    view: StringProperty(
        name="View",
        description="Name of the photograph; empty takes one that was kept aside",
        options={"SKIP_SAVE"},
    )

    def work(self, context: bpy.types.Context) -> None:
        """Make one image of the four."""
        paths = result_paths(context)
        self.report({"INFO"}, _show_comparison(context, paths, read_cameras(paths), self.view))


class ROBIR_OT_compare_next(ResultOperator, bpy.types.Operator):
    """The comparison of another view."""

    bl_idname = "robir.compare_next"
    bl_label = "Compare Next View"
    bl_description = "Compare the next view that was rendered again; arrow keys go on and back"
    bl_options = {"REGISTER", "UNDO"}

    step: IntProperty(name="Step", description="Views to go on by; negative goes back", default=1)

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Once a view was compared; as a key only over an editor that shows the comparison."""
        if not super().poll(context):
            return False
        shown = getattr(context.space_data, "image", None)
        image = bpy.data.images.get(COMPARISON)
        if image is None or VIEW not in image or shown not in (None, image):
            cls.poll_message_set(told("Press Compare first"))
            return False
        return True

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Go on; a key over anything but the comparison is somebody else's."""
        is_key = event.type in ("RIGHT_ARROW", "LEFT_ARROW")
        if is_key and getattr(context.space_data, "image", None) != bpy.data.images[COMPARISON]:
            return {"PASS_THROUGH"}
        return self.execute(context)

    def work(self, context: bpy.types.Context) -> None:
        """Compare the view so many steps on."""
        paths = result_paths(context)
        table = read_cameras(paths)
        view = neighbour(paths, table, bpy.data.images[COMPARISON][VIEW], self.step)
        self.report({"INFO"}, _show_comparison(context, paths, table, view))


def _show_comparison(
    context: bpy.types.Context, paths: JobPaths, table: dict[str, Any], view: str
) -> str:
    """Show the four pictures of a view under their names; returns these for the report."""
    found = compare(paths, table, view)
    image = put_image(COMPARISON, found.codes, mark_of(paths.root))
    again = words("Re-render by {renderer}", renderer=found.rendered_by)
    names = (words("Photograph"), again, words("Albedo"), words("Roughness"))
    title = words("View {name}, arrow keys for others", name=found.view)
    image[VIEW] = found.view
    image[CAPTIONS] = "\n".join((title, *names))
    show_image(context, image)
    return told("View {name}: {pictures}", name=found.view, pictures=", ".join(names))


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


_keys: list[tuple[bpy.types.KeyMap, bpy.types.KeyMapItem]] = []


def register() -> None:
    """Let the arrow keys over the comparison go from view to view.

    The image editor asks "Frames", which steps the timeline by them, before its own keys.
    """
    keys = bpy.context.window_manager.keyconfigs.addon
    if keys is None:  # without a window
        return
    keymap = keys.keymaps.new(name="Frames")
    for key, step in (("RIGHT_ARROW", 1), ("LEFT_ARROW", -1)):
        item = keymap.keymap_items.new(ROBIR_OT_compare_next.bl_idname, key, "PRESS")
        item.properties.step = step
        _keys.append((keymap, item))


def unregister() -> None:
    """Give the keys back."""
    while _keys:
        keymap, item = _keys.pop()
        keymap.keymap_items.remove(item)


CLASSES = (
    ROBIR_OT_import_result,
    ROBIR_OT_refresh_result,
    ROBIR_OT_remove_result,
    ROBIR_OT_compare,
    ROBIR_OT_compare_next,
    ROBIR_OT_match_view_transform,
    ROBIR_OT_open_report,
    ROBIR_OT_copy_report,
)
