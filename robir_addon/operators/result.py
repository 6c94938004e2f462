# SPDX-License-Identifier: GPL-3.0-or-later
"""Bring a result into the file, that of the sample too, and look at it."""

import hashlib
import shutil
import tempfile
from pathlib import Path

import bpy

from ..blocks import MARK, select_alone
from ..capture.viewport import bring_back
from ..child import own_folder
from ..engine.errors import ResultError
from ..relighting.lights import choose_light, world_of
from ..relighting.rendering import match_view_transform
from ..result.compositing import hide_few_views, show_few_views
from ..result.delight import give_back, target_of
from ..result.importer import (
    asset_of,
    bring_in,
    mark_of,
    read_cameras,
    read_tone_curve,
    remove_result,
)
from ..result.known import forget_former_spot
from ..result.materials import coverage_file, is_edited
from ..words import told
from ..work.support import support_report
from .capture import take_capture
from .shared import (
    Operator,
    WaitingOperator,
    at_rest,
    folder_property,
    has_result,
    in_object_mode,
    is_imported,
    result_asset,
    result_paths,
    result_root,
)


class ROBIR_OT_import_result(Operator, bpy.types.Operator):
    """Bring a finished result into the scene; importing it again replaces mesh and textures, and
    keeps place, modifiers, materials and light.
    """

    bl_label = "Import Result"
    needs = (in_object_mode,)

    directory: folder_property("Result", "Result folder; empty takes the one that is shown")

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        if not self.directory:
            self.directory = context.scene.robir.result
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}

    def work(self, context: bpy.types.Context) -> None:
        folder = self.directory or context.scene.robir.result
        if not folder:
            raise ResultError("no folder was given; choose one that `robir reconstruct` finished")
        root = Path(bpy.path.abspath(folder)).absolute()
        if is_edited(asset_of(root)):
            raise ResultError(
                "the object's mesh was edited and would be lost; press Refresh Result to have it "
                "replaced"
            )
        bring_in_result(self, context, root)


class ROBIR_OT_refresh_result(Operator, bpy.types.Operator):
    """Read mesh and textures anew; place, modifiers, materials and light stay as you made them."""

    bl_label = "Refresh Result"
    needs = (is_imported, in_object_mode)

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        if not is_edited(asset_of(result_root(context))):
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
        bring_in_result(self, context, result_root(context))


def bring_in_result(operator: bpy.types.Operator, context: bpy.types.Context, root: Path) -> None:
    """Import a result, or show it on the object of the user's that it is of, and say so."""
    notes = (bring_in if target_of(root) is None else give_back)(context, root)
    notes += forget_former_spot(context.scene.robir, root)
    for note in notes:
        operator.report({"INFO"}, note)
    context.window_manager.robir.message = ". ".join(notes)


class ROBIR_OT_remove_result(Operator, bpy.types.Operator):
    """Take the object, its light and its cameras out of the file and give the scene its own World
    back; the result folder stays.
    """

    bl_label = "Remove Result"
    needs = (is_imported,)

    def work(self, context: bpy.types.Context) -> None:
        remove_result(result_root(context))
        left = next((o for o in context.scene.objects if o.type == "MESH" and MARK in o), None)
        context.scene.robir.result = left[MARK] if left else ""
        if left:
            select_alone(context.view_layer, left)
        else:
            bring_back(context.scene, context.view_layer)


class ROBIR_OT_match_view_transform(Operator, bpy.types.Operator):
    """Show the scene through the tone curve that was recovered, as the photographs."""

    bl_label = "Match View Transform"
    needs = (has_result,)

    def work(self, context: bpy.types.Context) -> None:
        curve = read_tone_curve(result_paths(context))
        for note in match_view_transform(context.scene, curve):
            self.report({"WARNING"}, told(note))


class ROBIR_OT_show_few_views(Operator, bpy.types.Operator):
    """Tint what no photograph shows (red) and what fewer than three show (orange), where more would
    help. Press again to undo.
    """

    bl_label = "Where to Photograph Next"
    needs = (is_imported, in_object_mode)

    def work(self, context: bpy.types.Context) -> None:
        paths, mark = result_paths(context), mark_of(result_root(context))
        if not hide_few_views(mark):
            views = read_cameras(paths)["views"]
            count = sum(view["split"] == "train" for view in views)
            show_few_views(result_asset(context), coverage_file(paths), count, mark)


class ROBIR_OT_open_report(Operator, bpy.types.Operator):
    """Open the result's report, a file of your own, in the web browser."""

    bl_label = "Open Report"
    bl_options = {"REGISTER"}
    needs = (has_result,)

    def work(self, context: bpy.types.Context) -> None:
        report = result_paths(context).report
        if not report.is_file():
            raise ResultError("{file} is missing; export the result again", file=report.name)
        if bpy.app.background:
            self.report({"INFO"}, str(report))
        else:
            bpy.ops.wm.url_open(url=report.as_uri())


class ROBIR_OT_copy_report(Operator, bpy.types.Operator):
    """Copy versions, settings and the end of the log for a request for help; it holds no path of
    yours and not your name.
    """

    bl_label = "Copy Report"
    bl_options = {"REGISTER"}

    def execute(self, context: bpy.types.Context) -> set[str]:
        context.window_manager.clipboard = support_report(context)
        self.report({"INFO"}, told("The report is on the clipboard"))
        return {"FINISHED"}


# the result folder; its capture lies in it, under the same name
_SHIPPED = Path(__file__).parents[1] / "sample" / "avocado"
_LIGHT = "sunrise"  # what it is relit by: a low sun, unlike the light that it was photographed in


def is_sample(result: str) -> bool:
    """Whether a result folder is the one that came with the extension; touches no file."""
    return Path(bpy.path.abspath(result)).parts[-3::2] == _SHIPPED.parts[-2:]


class ROBIR_OT_try_sample(Operator, bpy.types.Operator):
    """Show the avocado that comes with RobIR, reconstructed from pictures of it and relit; nothing
    is downloaded, and no engine is needed.
    """

    bl_label = "Try the Sample"
    needs = (at_rest, in_object_mode)

    def work(self, context: bpy.types.Context) -> None:
        sample = _laid_out()
        bring_in_result(self, context, sample)
        choose_light(context.scene, world_of(mark_of(sample)), _LIGHT)
        text = "Relit by the light Sunrise; Relight has the light of the photographs and others"
        context.window_manager.robir.message = told(text)


class ROBIR_OT_reconstruct_sample(WaitingOperator, bpy.types.Operator):
    """Take the pictures of the sample, to be reconstructed by your own engine."""

    bl_label = "Reconstruct It Yourself"
    needs = (at_rest, in_object_mode)

    def begin(self, context: bpy.types.Context, way: str) -> set[str]:
        sample = _laid_out()
        remove_result(sample)  # its photographs and one's own result take its place
        return take_capture(context, sample / sample.name, way)


def _laid_out() -> Path:
    """The sample where a result may lie beside its capture.

    An update replaces the extension's own folder. Another content gets another folder, so that a
    newer sample touches neither what files show of the former nor what was made of it.
    """
    home = own_folder(create=True) or Path(bpy.app.tempdir)
    sample = home / "sample" / _digest(_SHIPPED) / _SHIPPED.name
    try:
        if not (sample / "run.json").is_file():
            sample.parent.mkdir(parents=True, exist_ok=True)
            part = Path(tempfile.mkdtemp(prefix=".laying-out-", dir=sample.parent))
            shutil.copytree(_SHIPPED, part, dirs_exist_ok=True)
            part.replace(sample)
    except OSError as fault:
        raise ResultError("The sample cannot be laid out: {fault}", fault=fault) from fault
    return sample


def _digest(folder: Path) -> str:
    """Eight letters that stand for the names and contents of a folder's files."""
    digest = hashlib.sha256()
    for file in sorted(f for f in folder.rglob("*") if f.is_file()):
        content = hashlib.sha256(file.read_bytes()).hexdigest()
        digest.update(f"{file.relative_to(folder).as_posix()} {content}\n".encode())
    return digest.hexdigest()[:8]
