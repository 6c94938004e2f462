# SPDX-License-Identifier: GPL-3.0-or-later
"""A capture's photographs, with a tick each; and captures that were reconstructed before."""

from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from typing import Any

import bpy

from ..child import own_folder
from ..gateway import read_json, write_json
from ..words import words
from .viewport import small_copy_name


class ROBIR_UL_photographs(bpy.types.UIList):
    """One photograph a line: tick, small copy, name, what the check noticed."""

    def draw_item(
        self,
        _context: bpy.types.Context,
        layout: bpy.types.UILayout,
        _data: bpy.types.AnyType,
        item: bpy.types.AnyType,
        _icon: int,
        _active_data: bpy.types.AnyType,
        _active_property: str,
    ) -> None:
        """Draw a line; Blender calls it for those that are seen."""
        row = layout.row(align=True)
        row.prop(item, "is_used", text="")
        small = bpy.data.images.get(small_copy_name(item.name))
        row.label(text=item.name, icon_value=layout.icon(small) if small else 0, translate=False)
        if item.reason:
            row.label(text=item.reason)


def draw_photographs(layout: bpy.types.UILayout, settings: Any) -> None:
    """A folded part of a panel with the list."""
    photographs = settings.photographs
    if not photographs and not settings.skip_missing:
        return
    used = sum(photograph.is_used for photograph in photographs)
    header, body = layout.panel("ROBIR_photographs", default_closed=True)
    text = words("Photographs ({used} of {count})", used=used, count=len(photographs))
    header.label(text=text)
    if body is not None:
        body.template_list(
            "ROBIR_UL_photographs", "", settings, "photographs", settings, "photograph_index"
        )
        body.prop(settings, "skip_missing")


def list_photographs(settings: Any, names: Iterable[str], findings: list[dict[str, Any]]) -> None:
    """Fill the list anew; photographs that were left out stay in it, left out."""
    photographs = settings.photographs
    left_out = [p.name for p in photographs if not p.is_used]
    noticed = {name: f["code"].replace("-", " ") for f in findings for name in f["files"]}
    photographs.clear()
    for name in dict.fromkeys([*names, *left_out]):
        shown = photographs.add()
        shown.name, shown.reason = name, noticed.get(name, "")
        shown.is_used = name not in left_out


def left_out_of(settings: Any) -> tuple[str, ...]:
    """Names of the photographs that the user has left out."""
    return tuple(p.name for p in settings.photographs if not p.is_used)


_MOST = 6
_NAME = "recent.json"

# capture and chosen result folder, absolute; read once, for panels show them
_known: list[tuple[str, str]] = []


def remember(capture: Path, out: str) -> None:
    """Put a capture at the head of the list; an empty `out` means beside it."""
    entry = (str(capture), out)
    _known[:] = [entry, *(known for known in _known if known[0] != entry[0])][:_MOST]
    folder = own_folder(create=True)
    if folder is not None:
        with suppress(OSError):  # the list is a help, no reason to stop
            write_json(folder / _NAME, {"captures": _known})


def recent_captures() -> list[str]:
    """Captures, the latest first; touches no file."""
    return [capture for capture, _ in _known]


def result_of(capture: Path) -> str:
    """Result folder that was chosen for a capture; empty for the one beside it."""
    return next((out for known, out in _known if known == str(capture)), "")


def register() -> None:
    """Read what earlier sessions have kept; a damaged list is an empty one."""
    folder = own_folder(create=False)
    try:
        kept = read_json(folder / _NAME)["captures"] if folder is not None else []
        _known[:] = [(str(capture), str(out)) for capture, out in kept][:_MOST]
    except (OSError, ValueError, KeyError, TypeError):
        _known.clear()


def unregister() -> None:
    """Forget what was read."""
    _known.clear()
