# SPDX-License-Identifier: GPL-3.0-or-later
"""What the operators on a finished result have in common."""

from pathlib import Path
from typing import TYPE_CHECKING

import bpy

from ..errors import AddonError
from ..gateway import JobPaths
from ..relighting.lights import world_of
from ..result.importer import active_result, mark_of
from ..words import told
from ..work.worker import problem_and_cure


def result_root(context: bpy.types.Context) -> Path:
    """The result folder of the active object, else the one that the panels show, absolute."""
    shown = active_result(context) or bpy.path.abspath(context.scene.robir.result)
    return Path(shown).absolute()


def result_paths(context: bpy.types.Context) -> JobPaths:
    """File names of that result."""
    return JobPaths(result_root(context))


def is_in_object_mode(operator: type[bpy.types.Operator], context: bpy.types.Context) -> bool:
    """Whether objects can be replaced; where not, the tool-tip says what to do."""
    if context.mode != "OBJECT":
        operator.poll_message_set(told("Leave the present mode for Object Mode first"))
        return False
    return True


_TAB = "RobIR"  # of the sidebar, where the panels are


def refused(operator: bpy.types.Operator, context: bpy.types.Context, sentence: str) -> None:
    """Report what the panel Notice says, unless it is seen: a pop-up would take the next click."""
    areas = context.screen.areas if context.screen and not bpy.app.background else ()
    regions = [r for area in areas if area.type == "VIEW_3D" for r in area.regions]
    tabs = [r.active_panel_category for r in regions if r.type == "UI" and r.width > 1]
    if _TAB not in tabs:
        operator.report({"ERROR"}, sentence)


MixedIn = bpy.types.Operator if TYPE_CHECKING else object
"""Base of what operators have in common, which counts on being mixed into one."""


class ResultOperator(MixedIn):
    """Runs `work`, and turns what it raises into one sentence for the user."""

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Once a result is shown."""
        if not context.scene.robir.result:
            cls.poll_message_set(told("Import a result first"))
            return False
        return True

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Do the work at once."""
        state = context.window_manager.robir
        state.error = state.error_cure = ""
        if not state.task:
            state.message = ""  # what was said of the last click
        try:
            self.work(context)
        except (AddonError, OSError) as error:
            return self.refuse(context, told(error))
        return {"FINISHED"}

    def work(self, context: bpy.types.Context) -> None:
        """What the operator is for.

        Raises:
            AddonError: With a sentence for the user.
        """
        raise NotImplementedError

    def refuse(self, context: bpy.types.Context, sentence: str) -> set[str]:
        """Say why nothing was done, here and in the panel."""
        state = context.window_manager.robir
        state.error, state.error_cure = problem_and_cure(sentence)
        refused(self, context, sentence)
        return {"CANCELLED"}


class ImportedOperator(ResultOperator):
    """Works on a result that is in the file."""

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Once the shown result was imported."""
        if not super().poll(context):
            return False
        if world_of(mark_of(result_root(context))) is None:
            cls.poll_message_set(told("The result is not in this file: import it again"))
            return False
        return True
