# SPDX-License-Identifier: GPL-3.0-or-later
"""A capture that comes with the extension: to see what RobIR does before photographing anything."""

import shutil
import tempfile
from pathlib import Path

import bpy

from ..home import own_folder
from ..words import told
from .capture import may_choose, take_capture

_SHIPPED = Path(__file__).parents[1] / "sample" / "truck"


class ROBIR_OT_try_sample(bpy.types.Operator):
    """The sample, in a folder that may be written to."""

    bl_idname = "robir.try_sample"
    bl_label = "Try the Sample"
    bl_description = (
        "Take the 48 pictures of a toy truck that come with RobIR; nothing is downloaded"
    )
    bl_options = {"REGISTER", "UNDO"}

    _way = "EXEC_DEFAULT"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Not while something is at work but the engine's installation."""
        return may_choose(cls, context)

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Do not make the user wait for the look at it."""
        self._way = "INVOKE_DEFAULT"
        return self.execute(context)

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Lay the sample out, once, and choose it."""
        try:
            capture = _laid_out()
        except OSError as fault:
            self.report({"ERROR"}, told("The sample cannot be laid out: {fault}", fault=fault))
            return {"CANCELLED"}
        return take_capture(self, context, capture, self._way)


def _laid_out() -> Path:
    """The sample where its result may lie beside it: an update replaces the extension's folder."""
    home = own_folder(create=True) or Path(bpy.app.tempdir)
    capture = home / "sample" / _SHIPPED.name
    if not capture.is_dir():
        capture.parent.mkdir(exist_ok=True)
        part = Path(tempfile.mkdtemp(prefix=".laying-out-", dir=capture.parent))
        shutil.copytree(_SHIPPED, part, dirs_exist_ok=True)
        part.replace(capture)
    return capture


CLASSES = (ROBIR_OT_try_sample,)
