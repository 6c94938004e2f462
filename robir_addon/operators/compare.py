# SPDX-License-Identifier: GPL-3.0-or-later
"""Photograph, re-render, albedo and roughness of a view: beside each other, or one over another."""

from contextlib import suppress
from pathlib import Path

import bpy
from bpy.props import IntProperty, StringProperty

from ..blocks import MARK
from ..capture.cameras import VIEW
from ..engine.errors import AddonError
from ..gateway import JobPaths
from ..result.importer import mark_of
from ..result.pictures import CAPTIONS, compare, compared_views, put_image, show_image, wiped
from ..words import told, words
from .shared import Operator, has_result, result_paths

COMPARISON = "RobIR comparison"


def _is_compared(context: bpy.types.Context) -> str:
    """A view was compared, and where an editor shows an image it is that."""
    shown, image = getattr(context.space_data, "image", None), bpy.data.images.get(COMPARISON)
    is_other = image is None or VIEW not in image or shown not in (None, image)
    return told("Press Compare first") if is_other else ""


class ROBIR_OT_compare(Operator, bpy.types.Operator):
    """Show a photograph, its re-render, albedo and roughness side by side."""

    bl_label = "Compare"
    needs = (has_result,)

    view: StringProperty(
        name="View",
        description="Name of the photograph; empty takes one that was held out",
        options={"SKIP_SAVE"},
    )

    def work(self, context: bpy.types.Context) -> None:
        self.report({"INFO"}, _show(context, result_paths(context), self.view))


class ROBIR_OT_compare_next(Operator, bpy.types.Operator):
    """Compare the next view that was rendered again; arrow keys go on and back."""

    bl_label = "Compare Next View"
    needs = (has_result, _is_compared)

    step: IntProperty(name="Step", description="Views to go on by; negative goes back", default=1)

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        is_key = event.type in ("RIGHT_ARROW", "LEFT_ARROW")
        if is_key and getattr(context.space_data, "image", None) != bpy.data.images[COMPARISON]:
            return {"PASS_THROUGH"}
        return self.execute(context)

    def work(self, context: bpy.types.Context) -> None:
        paths, view = result_paths(context), bpy.data.images[COMPARISON][VIEW]
        views = compared_views(paths)
        place = views.index(view) + self.step if view in views else 0
        self.report({"INFO"}, _show(context, paths, views[place % len(views)] if views else ""))


def _show(context: bpy.types.Context, paths: JobPaths, view: str, *, is_fitted: bool = True) -> str:
    """Show a view's pictures under their names, as the header's choice has it; says which."""
    view, codes = compare(paths, view)
    state = context.window_manager.robir
    renderer = "Cycles" if paths.rerender(view).is_file() else "RobIR"
    again = words("Re-render by {renderer}", renderer=renderer)
    names = [words("Photograph"), again, words("Albedo"), words("Roughness")]
    other = int(state.wipe_with)
    picture = wiped(codes, other, state.wipe) if other else codes
    image = put_image(COMPARISON, picture, mark_of(paths.root))
    title = words("View {name}, arrow keys for others", name=view)
    image[VIEW] = view
    shown = [f"{names[0]} | {names[other]}"] if other else names
    image[CAPTIONS] = "\n".join((title, *shown))
    if is_fitted:
        show_image(context, image)
    return told("View {name}: {pictures}", name=view, pictures=", ".join(names))


def draw_again(context: bpy.types.Context, *, is_fitted: bool) -> None:
    """Show the comparison as the header's choice has it now: wiped, or side by side."""
    image = bpy.data.images.get(COMPARISON)
    if image is not None and VIEW in image:
        with suppress(AddonError):  # the result's folder is gone
            _show(context, JobPaths(Path(image[MARK])), image[VIEW], is_fitted=is_fitted)


def _draw_header(header: bpy.types.Header, context: bpy.types.Context) -> None:
    """Buttons over an editor that shows the comparison."""
    image, state = context.space_data.image, context.window_manager.robir
    if image is None or image.name != COMPARISON or VIEW not in image:
        return
    row = header.layout.row(align=True)
    row.operator("robir.compare_next", text="", icon="TRIA_LEFT").step = -1
    row.operator("robir.compare_next", text="", icon="TRIA_RIGHT").step = 1
    row.operator("image.view_zoom_ratio", text="1:1").ratio = 1.0
    row.operator("image.view_all", text="Fit").fit_view = True
    row.prop(state, "wipe_with", text="")
    if int(state.wipe_with):
        row.prop(state, "wipe", slider=True)


# the image editor asks "Frames", which steps the timeline by them, before its own keys
KEYS = tuple(
    ("Frames", "EMPTY", key, ROBIR_OT_compare_next, {"step": step})
    for key, step in (("RIGHT_ARROW", 1), ("LEFT_ARROW", -1))
)


def register() -> None:
    """Let buttons over the comparison go from view to view."""
    bpy.types.IMAGE_HT_header.prepend(_draw_header)


def unregister() -> None:
    """Take them back."""
    bpy.types.IMAGE_HT_header.remove(_draw_header)
