# SPDX-License-Identifier: GPL-3.0-or-later
"""Size and place of a result, its ground taken away, and what is clicked that the user knows."""

import bpy
import gpu
from bpy.props import FloatProperty, FloatVectorProperty
from bpy_extras.view3d_utils import region_2d_to_origin_3d, region_2d_to_vector_3d
from gpu_extras.batch import batch_for_shader
from mathutils import Vector

from ..blocks import viewports
from ..engine.errors import RequestError, ResultError
from ..result.importer import asset_of, read_cameras
from ..result.known import (
    forget_spot,
    remember_spot,
    show_spot,
    sun_direction,
    texel_at,
    textured_object,
)
from ..result.materials import no_edit
from ..result.placing import (
    GROUND_SHARE,
    delete_faces,
    drop_ground,
    faces_outside,
    scale_result,
    stand,
)
from ..words import told, words
from .shared import (
    Operator,
    in_object_mode,
    is_imported,
    result_asset,
    result_paths,
    result_root,
    unless,
)

_PLACING = (is_imported, in_object_mode)


class ClickingOperator(Operator):
    """Lets the user click points of the object in the viewport; Esc leaves all as it is."""

    needs = _PLACING

    def asset(self, context: bpy.types.Context) -> bpy.types.Object:
        """What is clicked."""
        return result_asset(context)

    def begin(self, context: bpy.types.Context, sentence: str) -> set[str]:
        """Wait for clicks."""
        try:
            self._asset_name = self.asset(context).name
        except ResultError as error:
            return self.refuse(context, told(error))
        self.ruler = Ruler(sentence)
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        if event.type in {"ESC", "RIGHTMOUSE"}:
            self.ruler.remove()
            return {"CANCELLED"}
        if event.type != "LEFTMOUSE" or event.value != "PRESS":
            return {"PASS_THROUGH"}
        asset = context.scene.objects.get(self._asset_name)
        point = None if asset is None else _point_under_mouse(context, event, asset)
        if point is None:
            return {"RUNNING_MODAL"}
        self.ruler.add(point)
        return self.clicked(context)

    def clicked(self, context: bpy.types.Context) -> set[str]:
        raise NotImplementedError


class ROBIR_OT_set_real_size(ClickingOperator, bpy.types.Operator):
    """Click two points of the object and say how far apart they are; cameras and lamps go along,
    and the object's scale stays 1.
    """

    bl_label = "Set Real Size"

    first: FloatVectorProperty(
        name="First point", description="A point of the object, world", options={"SKIP_SAVE"}
    )
    second: FloatVectorProperty(
        name="Second point", description="Another point, world", options={"SKIP_SAVE"}
    )
    length: FloatProperty(
        name="Length",
        description="How far apart both points are in reality",
        subtype="DISTANCE",
        unit="LENGTH",
        min=0.0,
        options={"SKIP_SAVE"},
    )

    def invoke(self, context: bpy.types.Context, _event: bpy.types.Event) -> set[str]:
        if tuple(self.first) != tuple(self.second):
            return context.window_manager.invoke_props_dialog(self)
        return self.begin(context, words("Click a point of the object; Esc leaves all as it is"))

    def clicked(self, context: bpy.types.Context) -> set[str]:
        if len(self.ruler.points) < 2:
            self.ruler.say(words("Click the other point"))
            return {"RUNNING_MODAL"}
        first, second = self.ruler.points
        self.ruler.remove()
        length = (second - first).length
        bpy.ops.robir.set_real_size("INVOKE_DEFAULT", first=first, second=second, length=length)
        return {"CANCELLED"}  # nothing was changed by this one

    def draw(self, _context: bpy.types.Context) -> None:
        self.layout.prop(self, "length")

    def work(self, context: bpy.types.Context) -> None:
        asset = result_asset(context)
        measured = (Vector(self.second) - Vector(self.first)).length
        if measured <= 0.0 or self.length <= 0.0:
            raise RequestError("no length was given; click two points apart and say how far")
        with no_edit(asset):
            scale_result(asset, self.length / measured)
        context.view_layer.update()
        size = max(asset.dimensions)
        text = "{name} is {size:.4g} units in its longest direction"
        self.report({"INFO"}, told(text, name=asset.name, size=size))


class ROBIR_OT_stand_on_floor(Operator, bpy.types.Operator):
    """Put the object's origin to its foot, or the ground it was photographed on, and that to the
    middle of the floor; cameras and lamps go along.
    """

    bl_label = "Stand on Floor"
    needs = _PLACING

    def work(self, context: bpy.types.Context) -> None:
        asset, table = result_asset(context), read_cameras(result_paths(context))
        with no_edit(asset):
            stand(asset, table.get("ground"))


class ROBIR_OT_drop_ground(Operator, bpy.types.Operator):
    """Delete the ground that was photographed with the object, and crumbs; what stood on the floor
    stands again.
    """

    bl_label = "Drop Ground"
    needs = _PLACING

    height: FloatProperty(
        name="Height",
        description="Share of the object's radius above the ground up to which all is ground",
        default=GROUND_SHARE,
        min=0.0,
        soft_max=0.2,
    )

    def work(self, context: bpy.types.Context) -> None:
        table = read_cameras(result_paths(context))
        plane = table.get("ground")
        if plane is None:
            raise ResultError(
                "this result has no flat ground; Crop to Box takes away what is not wanted"
            )
        asset = result_asset(context)
        with no_edit(asset):
            drop_ground(asset, plane, self.height * table["bounds"]["radius"])


class ROBIR_OT_crop_to_box(Operator, bpy.types.Operator):
    """Delete what lies outside the object box of the panel Capture."""

    bl_label = "Crop to Box"
    needs = _PLACING

    def work(self, context: bpy.types.Context) -> None:
        box = context.scene.robir.box
        if box is None:
            raise RequestError("there is no object box; add one in the panel Capture and place it")
        asset = result_asset(context)
        delete_faces(asset, faces_outside(asset, box))


def _point_under_mouse(
    context: bpy.types.Context, event: bpy.types.Event, asset: bpy.types.Object
) -> Vector | None:
    """The point of the object under the mouse, world; None where there is none."""
    for area in context.screen.areas if context.screen else ():
        if area.type != "VIEW_3D":
            continue
        over = [r for r in area.regions if _is_over(r, event)]
        region = next((r for r in over if r.type == "WINDOW"), None)
        if region is None or len(over) > 1:  # the sidebar lies over the viewport
            continue
        place = Vector((event.mouse_x - region.x, event.mouse_y - region.y))
        view = area.spaces.active.region_3d
        origin = region_2d_to_origin_3d(region, view, place)
        towards = region_2d_to_vector_3d(region, view, place)
        into = asset.matrix_world.inverted()
        start = into @ origin
        is_hit, point, _, _ = asset.ray_cast(start, (into @ (origin + towards)) - start)
        if is_hit:
            return asset.matrix_world @ point
    return None


def _is_over(region: bpy.types.Region, event: bpy.types.Event) -> bool:
    x, y = event.mouse_x - region.x, event.mouse_y - region.y
    return 0 <= x < region.width and 0 <= y < region.height


class ROBIR_OT_pick_spot(ClickingOperator, bpy.types.Operator):
    """Click a spot of the object whose colour without light you know: a grey card, a label, a known
    paint. A script takes the one at the 3D cursor.
    """

    bl_label = "Pick Spot"

    def asset(self, context: bpy.types.Context) -> bpy.types.Object:
        """What shows the result's textures."""
        return textured_object(result_root(context))

    def invoke(self, context: bpy.types.Context, _event: bpy.types.Event) -> set[str]:
        text = "Click a spot whose colour you know; Esc leaves all as it is"
        return self.begin(context, words(text))

    def clicked(self, context: bpy.types.Context) -> set[str]:
        self.ruler.remove()
        self._place = self.ruler.points[0]
        return self.execute(context)

    def work(self, context: bpy.types.Context) -> None:
        root, shown = result_root(context), self.asset(context)
        place = getattr(self, "_place", context.scene.cursor.location)
        texel = texel_at(shown, place)
        remember_spot(context.scene.robir, root, texel)
        show_spot(shown, place)
        self.report({"INFO"}, told("The spot lies at {u:.3f}, {v:.3f}", u=texel[0], v=texel[1]))


class ROBIR_OT_forget_spot(Operator, bpy.types.Operator):
    """Reconstruct without a spot of known paint."""

    bl_label = "Forget Spot"
    needs = (unless(lambda c: c.scene.robir.spot_result, "No spot was picked"),)

    def work(self, context: bpy.types.Context) -> None:
        forget_spot(context.scene.robir)


class ROBIR_OT_take_sun(Operator, bpy.types.Operator):
    """Tell where the sun stood: take the direction of the selected Sun lamp, which shines on the
    object as the sun did on the photographs.
    """

    bl_label = "Sun from Lamp"
    needs = (
        unless(
            lambda c: c.object and c.object.type == "LIGHT" and c.object.data.type == "SUN",
            "Select a Sun lamp that shines as the sun did",
        ),
    )

    def work(self, context: bpy.types.Context) -> None:
        settings = context.scene.robir
        shown = asset_of(result_root(context)) if settings.result else None
        settings.sun = sun_direction(context.object, shown)  # in the capture's own frame


class ROBIR_OT_forget_sun(Operator, bpy.types.Operator):
    """Let the reconstruction look for suns by itself."""

    bl_label = "Forget Sun"
    needs = (unless(lambda c: any(c.scene.robir.sun), "No direction was taken"),)

    def work(self, context: bpy.types.Context) -> None:
        context.scene.robir.property_unset("sun")


_COLOUR = (1.0, 0.55, 0.1, 1.0)


class Ruler:
    """Points, world, drawn in all viewports until removed; a sentence stands in the status bar."""

    def __init__(self, sentence: str) -> None:
        self.points: list[Vector] = []
        space = bpy.types.SpaceView3D
        self._handle = space.draw_handler_add(self._draw, (), "WINDOW", "POST_VIEW")
        self.say(sentence)

    def say(self, sentence: str) -> None:
        """Tell the user what comes next."""
        bpy.context.workspace.status_text_set(sentence)
        _redraw()

    def add(self, point: Vector) -> None:
        """Show one more point."""
        self.points.append(point)
        _redraw()

    def remove(self) -> None:
        """Take it all away."""
        bpy.types.SpaceView3D.draw_handler_remove(self._handle, "WINDOW")
        bpy.context.workspace.status_text_set(None)
        _redraw()

    def _draw(self) -> None:
        shader = gpu.shader.from_builtin("UNIFORM_COLOR")
        gpu.state.depth_test_set("NONE")
        gpu.state.point_size_set(9.0)
        gpu.state.line_width_set(2.0)
        shader.uniform_float("color", _COLOUR)
        for kind in ("POINTS", "LINE_STRIP"):
            batch_for_shader(shader, kind, {"pos": [tuple(p) for p in self.points]}).draw(shader)
        gpu.state.point_size_set(1.0)
        gpu.state.line_width_set(1.0)


def _redraw() -> None:
    for area in viewports():
        area.tag_redraw()
