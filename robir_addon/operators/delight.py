# SPDX-License-Identifier: GPL-3.0-or-later
"""De-light: the selected object's texture anew, from the photographs and without their light."""

from dataclasses import replace

import bpy

from ..gateway import client
from ..result.delight import TARGET, mesh_file
from ..result.importer import mark_of
from ..words import told
from ..work.worker import request_of, result_folder
from .reconstruct import WorkerOperator
from .shared import is_in_object_mode


class ROBIR_OT_delight(WorkerOperator, bpy.types.Operator):
    """From photographs and the object they show to its texture without light."""

    bl_idname = "robir.delight"
    bl_label = "De-light Object"
    bl_description = (
        "Make a material without shadows and highlights for the selected object, which stands "
        "where the capture's photographs show it, or anywhere if these have no cameras; its own "
        "material stays in its slot"
    )
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """With a mesh object, a capture and an engine, while nothing is at work."""
        target = context.object
        if target is None or target.type != "MESH" or not target.select_get():
            cls.poll_message_set(told("Select the mesh object that the photographs show"))
            return False
        return is_in_object_mode(cls, context) and super().poll(context)

    def request(self, context: bpy.types.Context) -> client.Request:
        """What to ask of the engine; the object is written beside the result."""
        settings, target = context.scene.robir, context.object
        result = result_folder(settings)
        assert result is not None
        file = mesh_file(target, settings, result)
        root = file.with_suffix("")
        target[TARGET] = mark_of(root)
        return replace(request_of(settings), out=root, mesh=file)


CLASSES = (ROBIR_OT_delight,)
