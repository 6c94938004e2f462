# SPDX-License-Identifier: GPL-3.0-or-later
"""What a reconstruction is asked for, where its result goes, its sentences in the panel's words.

Knows no Blender data beyond the settings it is handed.
"""

import os
from itertools import product
from pathlib import Path
from typing import Any

import bpy
from mathutils import Vector

from ..capture.photographs import left_out_of
from ..gateway import client
from ..result.known import known_of, size_of

# what the command line calls a thing, and what it is called in the panel
_WORDS = (
    ("; continue with --resume", "; press Reconstruct to go on"),
    ("then continue with --resume", "then press Reconstruct to go on"),
    ("continue it with --resume", "press Reconstruct to go on"),
    ("redo the stages concerned with --resume", "press Reconstruct to redo what differs"),
    ("install it with: pip install 'bpy>=4.5,<5.1' (Python 3.11), then run again with --resume",
     "press Check Engine"),
    ("give another output folder with -o", "choose another result folder"),
    ("give a new or empty folder with -o", "choose a new or empty result folder"),
    ("give another output folder", "choose another result folder"),
    ("give another with -o", "choose another result folder"),
    ("give all masks with --masks DIR", "choose their folder as Masks"),
    ("Masks will be needed as well (--masks DIR)", "Masks will be needed as well"),
    ("with --masks DIR", "in a folder chosen as Masks"),
    ("Or say where the object is with the setting capture.box=[x, y, z, width, depth, height].",
     "Or press Add Object Box and move it about the object."),
    ("do without them with --skip-missing", "press Leave Out"),
    ("with --set, ", "or choose 2K as Texture, "),
    (", or try another --seed", ""),
    ("run `robir check` on the capture", "look at the findings under Capture"),
    ("Run `robir check` and look", "Look"),
    ("have that done with --fit-mesh and --resume, or export the mesh in the cameras' frame",
     "move the object there"),
    ("use --device cpu", "choose the processor as Device"),
)  # fmt: skip


def in_panel_words(sentence: str) -> str:
    """A sentence of the command line as someone needs it who sees only the panel."""
    for theirs, ours in _WORDS:
        sentence = sentence.replace(theirs, ours)
    return sentence


def problem_and_cure(sentence: str) -> tuple[str, str]:
    """A sentence of the worker taken apart: what is wrong, and what to do about it."""
    problem, _, cure = in_panel_words(sentence).partition("; ")
    return problem[:1].upper() + problem[1:], cure[:1].upper() + cure[1:]


def absolute(path: str) -> Path | None:
    """A folder of the settings as an absolute path; None where none is chosen."""
    # normalised without a look at the disk: a link to a capture keeps its own name
    return Path(os.path.normpath(Path(bpy.path.abspath(path)).absolute())) if path else None


def result_folder(settings: Any) -> Path | None:
    """Where the result of the chosen capture goes; None where no capture is chosen."""
    capture = absolute(settings.capture)
    if settings.out or capture is None:
        return absolute(settings.out)
    folder = capture if capture.suffix.lower() not in (".json", ".npz") else capture.parent
    return folder.with_name(f"{folder.name}_robir")


def shown_box(settings: Any) -> bpy.types.Object | None:
    """The box about the object; None without one, or where it was deleted from the scene."""
    chosen = settings.box  # as long as this points to it, deleting it leaves it in the file
    in_scene = chosen is not None and settings.id_data.objects.get(chosen.name) == chosen
    return chosen if in_scene else None


def box_of(settings: Any) -> tuple[float, ...]:
    """Centre and sides of the box about the object, the capture's own frame; empty without one."""
    chosen = shown_box(settings)
    if chosen is None:
        return ()
    bpy.context.view_layer.update()  # a script may have moved it just now
    if chosen.type == "EMPTY":
        size = chosen.empty_display_size
        corners = [Vector(signs) * size for signs in product((-1.0, 1.0), repeat=3)]
    else:
        corners = [Vector(corner) for corner in chosen.bound_box]
    shift, scale = Vector(settings.view_shift), settings.view_scale
    placed = [(chosen.matrix_world @ corner - shift) / scale for corner in corners]
    columns = list(zip(*placed, strict=True))
    centre = [0.5 * (min(column) + max(column)) for column in columns]
    return (*centre, *(max(column) - min(column) for column in columns))


def request_of(settings: Any) -> client.Request:
    """The reconstruction that the settings ask for; a capture is chosen."""
    capture, out = absolute(settings.capture), result_folder(settings)
    assert capture is not None
    assert out is not None
    return client.Request(
        capture=capture,
        out=out,
        device=settings.device,
        masks=absolute(settings.masks),
        box=box_of(settings),
        skips_missing=settings.skip_missing,
        left_out=left_out_of(settings),
        settings=(*size_of(settings), *known_of(settings)),
    )


def program(python: Path) -> list[str]:
    """Words that start the engine's command line; the current folder is not searched for it."""
    return [str(python), "-P", "-m", "robir"]
