# SPDX-License-Identifier: GPL-3.0-or-later
"""A finished sample that comes with the extension: relit at once, without an engine."""

import hashlib
import shutil
import tempfile
from pathlib import Path

import bpy

from ..errors import ResultError
from ..home import own_folder
from ..relighting.lights import choose_light, world_of
from ..result.importer import mark_of, remove_result
from ..words import told
from .capture import take_capture
from .result import bring_in_result
from .shared import Operator, WaitingOperator, at_rest, in_object_mode

_SHIPPED = Path(__file__).parents[1] / "sample" / "avocado"
"""The result folder; its capture lies in it, under the same name."""

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
