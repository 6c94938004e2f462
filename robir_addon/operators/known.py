# SPDX-License-Identifier: GPL-3.0-or-later
"""What the user knows of the capture: the paint of one spot, and where the sun stood."""

import bpy

from ..result.importer import asset_of
from ..result.known import show_spot, sun_direction, texel_at, textured_object
from ..words import told, words
from ..work.known import forget_spot, remember_spot
from .placing import ClickingOperator
from .shared import Operator, result_root


def _has_spot(context: bpy.types.Context) -> str:
    return "" if context.scene.robir.spot_result else told("No spot was picked")


def _has_lamp(context: bpy.types.Context) -> str:
    lamp = context.object
    is_sun = lamp is not None and lamp.type == "LIGHT" and lamp.data.type == "SUN"
    return "" if is_sun else told("Select a Sun lamp that shines as the sun did")


def _has_sun(context: bpy.types.Context) -> str:
    return "" if any(context.scene.robir.sun) else told("No direction was taken")


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
    needs = (_has_spot,)

    def work(self, context: bpy.types.Context) -> None:
        forget_spot(context.scene.robir)


class ROBIR_OT_take_sun(Operator, bpy.types.Operator):
    """Tell where the sun stood: take the direction of the selected Sun lamp, which shines on the
    object as the sun did on the photographs.
    """

    bl_label = "Sun from Lamp"
    needs = (_has_lamp,)

    def work(self, context: bpy.types.Context) -> None:
        settings = context.scene.robir
        shown = asset_of(result_root(context)) if settings.result else None
        settings.sun = sun_direction(context.object, shown)  # in the capture's own frame


class ROBIR_OT_forget_sun(Operator, bpy.types.Operator):
    """Let the reconstruction look for suns by itself."""

    bl_label = "Forget Sun"
    needs = (_has_sun,)

    def work(self, context: bpy.types.Context) -> None:
        context.scene.robir.property_unset("sun")
