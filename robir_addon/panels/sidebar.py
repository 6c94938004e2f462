# SPDX-License-Identifier: GPL-3.0-or-later
"""The sidebar's tab, its panels in order of work; they draw what is known and decide nothing.

What the result's report says was read by `summary`, what goes on comes from
`WindowManager.robir`, which `monitor` fills; drawing itself reads nothing.
"""

from pathlib import Path

import bpy

from ..capture.photographs import draw_photographs, recent_captures
from ..capture.viewport import COLLECTION, GAP, GAPS
from ..engine import CAN_INSTALL
from ..operators.capture import can_leave_out
from ..operators.engine import has_notice, is_offline
from ..operators.result import is_sample
from ..paragraphs import (
    Panel,
    ResultPanel,
    advice,
    big,
    paragraph,
    preferences_button,
    progress,
    split,
)
from ..preferences import draw_engine, install_text, shown_engine_status
from ..relighting.lights import light_pictures, strength_of
from ..result.summary import shown_summary
from ..words import told, words
from ..work import batch, growth
from ..work.worker import shown_box

_MOST_RECENT = 3  # captures; File > Import has all folders
_FAULT_ICONS = {"error": "CANCEL", "warning": "ERROR"}
_QUEUE_ICONS = {"failed": "CANCEL", "running": "PLAY", "done": "CHECKMARK", "dropped": "X"}
_STAGES = {
    "capture": "Photographs",
    "geometry": "Shape",
    "transport": "Visibility",
    "appearance": "Light and materials",
    "export": "Files and report",
}


class ROBIR_PT_notice(Panel, bpy.types.Panel):
    """What went wrong last, or what came of the last work, above everything else."""

    bl_label = "Notice"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        state = context.window_manager.robir
        status = shown_engine_status(context)
        is_below = status.state != "ready" and state.error == told(status.text)
        if is_below or (is_offline(state) and bpy.app.online_access):
            return False
        return has_notice(state)

    def draw_header_preset(self, context: bpy.types.Context) -> None:
        self.layout.operator("robir.dismiss", text="", icon="X", emboss=False)

    def draw(self, context: bpy.types.Context) -> None:
        state, layout = context.window_manager.robir, self.layout
        if not state.error:
            paragraph(layout, context, state.message, "INFO")
            return
        # in the theme's own colour of text: its red for alerts cannot be read on every background
        advice(layout, context, state.error, state.error_cure, "ERROR")
        if is_offline(state):
            layout.operator("robir.allow_online", icon="URL")
        layout.operator("robir.copy_report", icon="COPYDOWN")


class ROBIR_PT_no_engine(Panel, bpy.types.Panel):
    """The way to an engine, above the work that needs one."""

    bl_label = "Engine Needed"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        at_work = context.window_manager.robir.task == "install"
        is_asked = at_work or context.scene.robir.capture or not context.scene.robir.result
        return bool(is_asked) and shown_engine_status(context).state != "ready"

    def draw(self, context: bpy.types.Context) -> None:
        status, box = shown_engine_status(context), self.layout.box()
        if context.window_manager.robir.task == "install":
            box.label(text="Installing the engine", icon="IMPORT")
            progress(box, context)
            return
        advice(box, context, told(status.text), told(status.cure), "INFO")
        row = big(box)
        if CAN_INSTALL:
            row.operator("robir.install_engine", text=install_text(context), icon="IMPORT")
        preferences_button(row, text="" if CAN_INSTALL else words("Preferences"))


class ROBIR_PT_capture(Panel, bpy.types.Panel):
    """Which photographs, and what they were recognised as; folded once there is a result."""

    bl_label = "Capture"

    def draw(self, context: bpy.types.Context) -> None:
        layout, settings = self.layout, context.scene.robir
        if not _is_over(context):
            _draw_capture(layout, context)
            return
        header, body = layout.panel("ROBIR_steps", default_closed=True)
        header.label(text="Photographs and Shape", icon="CHECKMARK")
        if body is not None:
            _draw_capture(body, context)
            if settings.capture:
                _draw_choices(body, context)


def _draw_capture(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    """Choose a folder; then its name and what is in it."""
    settings, state = context.scene.robir, context.window_manager.robir
    if not settings.capture:
        big(layout).operator("robir.try_sample", icon="OUTLINER_OB_IMAGE")
        big(layout).operator("robir.choose_capture", icon="FILE_FOLDER")
        text = "Or drop a photograph, a video or a file of camera poses into the viewport"
        paragraph(layout, context, words(text), "INFO")
        for capture in recent_captures()[:_MOST_RECENT]:
            recent = layout.operator(
                "robir.choose_capture", text=_name(capture), icon="FILE_FOLDER", translate=False
            )
            recent.directory = capture
        if not settings.result:
            layout.operator("robir.import_result", icon="IMPORT")
        return
    row = layout.row(align=True)
    row.label(text=_name(settings.capture), icon="FILE_FOLDER", translate=False)
    cameras = bpy.data.collections.get(COLLECTION)
    if cameras is not None:
        # the icon that Blender has one before this stands for the other state
        row.prop(cameras, "hide_viewport", text="", icon="HIDE_OFF")
    row.operator("robir.choose_capture", text="", icon="FILEBROWSER")
    row.operator("robir.look_at_capture", text="", icon="FILE_REFRESH")
    row.operator("robir.clear_capture", text="", icon="X")
    if state.task == "look":
        progress(layout, context)
    elif state.recognised and _is_looked_at(context):
        paragraph(layout, context, state.recognised, "CHECKMARK")
    if _is_looked_at(context) and (state.recognised or state.findings):
        _draw_check(layout, context)
    header, body = layout.panel("ROBIR_object", default_closed=True)
    header.label(text="Masks and Photographs")
    if body is None:
        return
    choices = split(body)
    choices.prop(settings, "masks")
    row = choices.row(align=True)
    row.prop(settings, "box")
    if shown_box(settings) is None:
        row.operator("robir.add_box", text="", icon="ADD")
    draw_photographs(body, settings)


def _draw_check(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    """Faults in boxes, worst first, each with its cure; what is only good to know folded away."""
    settings, findings = context.scene.robir, list(context.window_manager.robir.findings)
    faults = [f for level in _FAULT_ICONS for f in findings if f.level == level]
    notes = [f for f in findings if f.level == "note"]
    if not faults:
        layout.label(text="No faults found", icon="CHECKMARK")
    for fault in faults:
        box = layout.box()
        advice(box, context, fault.text, fault.cure, _FAULT_ICONS[fault.level])
        gaps = bpy.data.collections.get(GAPS)
        if fault.code == GAP and gaps is not None:
            box.prop(gaps, "hide_viewport", text="Show Missing Sides", invert_checkbox=True)
        if can_leave_out(fault, settings):
            box.operator("robir.leave_out").finding = findings.index(fault)
    if notes:
        header, body = layout.panel("ROBIR_notes", default_closed=True)
        header.label(text=words("Good to know ({count})", count=len(notes)))
        for note in notes if body is not None else ():
            paragraph(body, context, f"{note.text}. {note.cure}" if note.cure else note.text)


class ROBIR_PT_reconstruct(Panel, bpy.types.Panel):
    """The few choices that matter, one button, and how far it is."""

    bl_label = "Reconstruct"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        at_work = context.window_manager.robir.task == "reconstruct"
        return at_work or (bool(context.scene.robir.capture) and not _is_over(context))

    def draw(self, context: bpy.types.Context) -> None:
        state, layout = context.window_manager.robir, self.layout
        if state.task != "reconstruct":
            _draw_choices(layout, context)
            return
        if state.stage:
            layout.label(text=_STAGES.get(state.stage, state.stage.capitalize()))
        progress(layout, context)
        pictures = layout.row(align=True)
        for icon in growth.icons():
            pictures.template_icon(icon_value=icon, scale=5.5)


def _draw_choices(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    """What is asked for, and the button that begins."""
    settings = context.scene.robir
    split(layout).prop(settings, "texture")
    big(layout).operator("robir.reconstruct", icon="PLAY")
    layout.operator("robir.delight", icon="SHADING_TEXTURE")
    header, body = layout.panel("ROBIR_choices", default_closed=True)
    header.label(text="Device and Folder")
    if body is not None:
        column = split(body)
        column.prop(settings, "device")
        column.prop(settings, "out")


class ROBIR_PT_result(ResultPanel, bpy.types.Panel):
    """What came out, beside what went in."""

    bl_label = "Result"

    def draw(self, context: bpy.types.Context) -> None:
        layout, settings = self.layout, context.scene.robir
        row = layout.row(align=True)
        row.prop(settings, "shown", text="")
        row.menu("ROBIR_MT_result", text="", icon="DOWNARROW_HLT")
        if is_sample(settings.result):
            big(layout).operator("robir.reconstruct_sample", icon="PLAY")
        row = layout.row(align=True)
        row.operator("robir.compare", icon="IMAGE_REFERENCE")
        row.operator("robir.open_report", icon="URL")
        summary = shown_summary(settings)
        if summary is None:
            return
        paragraph(layout, context, summary.verdict, "ERROR" if summary.reason else "CHECKMARK")
        if summary.reason:
            paragraph(layout, context, summary.reason)
        header, body = layout.panel("ROBIR_details", default_closed=True)
        header.label(text="Details")
        if body is not None:
            facts = body.column(align=True)
            for fact in summary.facts:
                paragraph(facts, context, fact, "DOT")
            for warning in summary.warnings:
                paragraph(body, context, warning)
            body.operator("robir.show_few_views", icon="HIDE_OFF")
            body.operator("robir.match_view_transform", icon="COLOR")


class ROBIR_PT_place(ResultPanel, bpy.types.Panel):
    """The result in its real size, and what is not wanted of it."""

    bl_label = "Size and Place"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, _context: bpy.types.Context) -> None:
        column = self.layout.column(align=True)
        column.operator("robir.set_real_size", icon="DRIVER_DISTANCE")
        column.operator("robir.stand_on_floor", icon="TRIA_DOWN_BAR")
        column = self.layout.column(align=True)
        column.operator("robir.drop_ground", icon="MOD_BOOLEAN")
        column.operator("robir.crop_to_box", icon="MESH_CUBE")


class ROBIR_PT_relight(ResultPanel, bpy.types.Panel):
    """The recovered light, or another."""

    bl_label = "Relight"

    def draw(self, context: bpy.types.Context) -> None:
        layout, settings = self.layout, context.scene.robir
        strength, task = strength_of(context.scene), context.window_manager.robir.task
        layout.prop(settings, "light", text="")
        if light_pictures(settings.result):
            layout.template_icon_view(settings, "light", show_labels=True, scale=7.0)
        elif task != "lights":
            big(layout).operator("robir.picture_lights", icon="LIGHTPROBE_SPHERE")
        column = split(layout)
        if strength is not None:
            column.prop(strength, "default_value", text="Strength")
        column.prop(settings, "rotation")
        if task in ("turntable", "lights"):
            progress(layout, context)
        header, body = layout.panel("ROBIR_film", default_closed=True)
        header.label(text="Photograph, Film, Own Lights")
        if body is not None:
            body.operator("robir.into_photograph", icon="IMAGE_BACKGROUND")
            body.operator("robir.use_environment", icon="FILEBROWSER")
            column = split(body)
            column.prop(settings, "light_folder")
            column.prop(settings, "use_sun_lamp")
            column.prop(settings, "turns")
            column.prop(settings, "turntable_frames")
            column.prop(settings, "turntable_side")
            body.operator("robir.turntable", icon="RENDER_ANIMATION")


class ROBIR_PT_export(ResultPanel, bpy.types.Panel):
    """The result in files for other programs."""

    bl_label = "Export"

    def draw(self, context: bpy.types.Context) -> None:
        big(self.layout).operator("robir.export_game", icon="FILE_3D")
        self.layout.menu("ROBIR_MT_exports", icon="EXPORT")


class ROBIR_MT_result(bpy.types.Menu):
    """Results brought in, read anew and taken out."""

    bl_label = "Result"

    def draw(self, _context: bpy.types.Context) -> None:
        for name in ("import_result", "refresh_result", "remove_result"):
            self.layout.operator(f"robir.{name}")


class ROBIR_MT_exports(bpy.types.Menu):
    """The object as it stands in the scene, in files."""

    bl_label = "GLB, USD, Textures"

    def draw(self, _context: bpy.types.Context) -> None:
        for name in ("export_glb", "export_usd", "export_textures", "mark_asset"):
            self.layout.operator(f"robir.{name}")


class ROBIR_PT_library(Panel, bpy.types.Panel):
    """Many captures: what is done of them, and their assets."""

    bl_label = "Library"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: bpy.types.Context) -> None:
        layout, known = self.layout, batch.shown()
        split(layout).prop(context.scene.robir, "library")
        row = big(layout)
        if known.is_live:
            row.operator("robir.stop_batch", icon="PAUSE")
        else:
            row.operator("robir.run_batch", icon="PLAY")
        if known.captures:
            layout.progress(factor=known.fraction, type="BAR", text=known.text)
        for name, state, message in known.captures[: batch.MOST]:
            line = layout.row(align=True)
            text = f"{name}: {message}" if message else name
            line.label(text=text, icon=_QUEUE_ICONS.get(state, "DOT"), translate=False)
            if state == "waiting":
                line.operator("robir.prefer_in_batch", text="", icon="TRIA_UP").name = name
            if state in ("waiting", "running"):
                line.operator("robir.drop_from_batch", text="", icon="X").name = name
        if len(known.captures) > batch.MOST:
            more = words("and {count} more", count=len(known.captures) - batch.MOST)
            layout.label(text=more, translate=False)
        layout.operator("robir.add_library", icon="ASSET_MANAGER")


class ROBIR_PT_engine(Panel, bpy.types.Panel):
    """What computes: whether it works, and how to get it."""

    bl_label = "Engine"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: bpy.types.Context) -> None:
        draw_engine(self.layout, context)
        preferences_button(self.layout, text=words("Preferences"))


def _is_over(context: bpy.types.Context) -> bool:
    """Whether photographs and their reconstruction are done, and what is next is the result."""
    at_work = context.window_manager.robir.task == "reconstruct"
    return bool(context.scene.robir.result) and not at_work


def _is_looked_at(context: bpy.types.Context) -> bool:
    """Whether what is known is about the chosen capture, which undo may have changed."""
    looked_at = context.window_manager.robir.looked_at
    return bool(looked_at) and looked_at == context.scene.robir.capture


def _name(folder: str) -> str:
    return Path(bpy.path.abspath(folder)).name
