# SPDX-License-Identifier: GPL-3.0-or-later
"""What the user knows of the capture: the paint of one spot, and where the sun stood."""

import bpy

from ..result.importer import asset_of
from ..result.known import show_spot, sun_direction, texel_at, textured_object
from ..words import told, words
from ..work.known import forget_spot, remember_spot
from .placing import ClickingOperator
from .shared import result_root


class ROBIR_OT_pick_spot(ClickingOperator, bpy.types.Operator):
    """A spot of the result whose paint is known."""

    bl_idname = "robir.pick_spot"
    bl_label = "Pick Spot"
    bl_description = (
        "Click a spot of the object whose colour without light you know: a grey card, a label, "
        "a known paint. A script takes the one at the 3D cursor"
    )
    bl_options = {"REGISTER", "UNDO"}

    def asset(self, context: bpy.types.Context) -> bpy.types.Object:
        """What shows the result's textures."""
        return textured_object(result_root(context))

    def invoke(self, context: bpy.types.Context, _event: bpy.types.Event) -> set[str]:
        """Let the user click it."""
        text = "Click a spot whose colour you know; Esc leaves all as it is"
        return self.begin(context, words(text))

    def clicked(self, context: bpy.types.Context) -> set[str]:
        """Take it."""
        self.ruler.remove()
        self._place = self.ruler.points[0]
        return self.execute(context)

    def work(self, context: bpy.types.Context) -> None:
        """Find its place on the texture, remember that and show it by a dot."""
        root, shown = result_root(context), self.asset(context)
        place = getattr(self, "_place", context.scene.cursor.location)
        texel = texel_at(shown, place)
        remember_spot(context.scene.robir, root, texel)
        show_spot(shown, place)
        self.report({"INFO"}, told("The spot lies at {u:.3f}, {v:.3f}", u=texel[0], v=texel[1]))


class ROBIR_OT_forget_spot(bpy.types.Operator):
    """No spot of known paint any more."""

    bl_idname = "robir.forget_spot"
    bl_label = "Forget Spot"
    bl_description = "Reconstruct without a spot of known paint"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Once one was picked."""
        if not context.scene.robir.spot_result:
            cls.poll_message_set(told("No spot was picked"))
            return False
        return True

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Forget it."""
        forget_spot(context.scene.robir)
        return {"FINISHED"}


class ROBIR_OT_take_sun(bpy.types.Operator):
    """The direction of a Sun lamp as that of the capture's sun."""

    bl_idname = "robir.take_sun"
    bl_label = "Sun from Lamp"
    bl_description = (
        "Tell where the sun stood: take the direction of the selected Sun lamp, which shines on "
        "the object as the sun did on the photographs"
    )
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """With a Sun lamp as the active object."""
        lamp = context.object
        if lamp is None or lamp.type != "LIGHT" or lamp.data.type != "SUN":
            cls.poll_message_set(told("Select a Sun lamp that shines as the sun did"))
            return False
        return True

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Remember the direction in the capture's own frame."""
        settings = context.scene.robir
        shown = asset_of(result_root(context)) if settings.result else None
        settings.sun = sun_direction(context.object, shown)
        return {"FINISHED"}


class ROBIR_OT_forget_sun(bpy.types.Operator):
    """No known sun any more."""

    bl_idname = "robir.forget_sun"
    bl_label = "Forget Sun"
    bl_description = "Let the reconstruction look for suns by itself"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Once a direction was taken."""
        if not any(context.scene.robir.sun):
            cls.poll_message_set(told("No direction was taken"))
            return False
        return True

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Forget it."""
        context.scene.robir.property_unset("sun")
        return {"FINISHED"}


CLASSES = (
    ROBIR_OT_pick_spot,
    ROBIR_OT_forget_spot,
    ROBIR_OT_take_sun,
    ROBIR_OT_forget_sun,
)
