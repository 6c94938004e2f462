# SPDX-License-Identifier: GPL-3.0-or-later
"""Texts in the user's language: the one door to Blender's translations, and the catalogues.

What Blender is told as it stands (names, descriptions, the text of a button or a label) it looks up
by itself. What is filled in, put together, broken into lines or kept for later is looked up here,
before its fields are filled. Every `locale/LANGUAGE.po` is a catalogue.
"""

import ast
import re
from pathlib import Path

import bpy

from .engine.errors import Sentence

_LOCALE = Path(__file__).with_name("locale")
_ANY = "*"  # Blender's name for what a catalogue gives no context
_LINE = re.compile(r'(?:(msgctxt|msgid|msgstr)\s+)?(".*")')


def words(text: str, /, **values: object) -> str:
    """A text that is drawn, in the language of the interface."""
    return _filled(bpy.app.translations.pgettext_iface(text), values)


def told(said: str | Exception, /, **values: object) -> str:
    """What is reported, refused or went wrong, an error itself too, in the language of reports."""
    if isinstance(said, Exception):
        return "; ".join(map(told, getattr(said, "sentences", (str(said),))))
    if isinstance(said, Sentence):
        said, values = said.text, said.values
    return _filled(bpy.app.translations.pgettext_rpt(said), values)


def reported(fault: RuntimeError) -> str:
    """What an operator reported that another one has called, without Blender's words before it."""
    kind = bpy.app.translations.pgettext_rpt("Error")
    return (
        str(fault)
        .rpartition(".poll() ")[2]
        .removeprefix("Error: ")
        .removeprefix(f"{kind}: ")
        .strip()
    )


def read_catalogue(file: Path) -> dict[tuple[str, str], str]:
    """Translations of a .po file by context and English text, none that are empty or fuzzy."""
    known = {}
    for block in re.split(r"\n\s*\n", file.read_text(encoding="utf-8")):
        lines = block.splitlines()
        if any(line.startswith("#,") and "fuzzy" in line for line in lines):
            continue
        entry, field = {"msgctxt": "", "msgid": "", "msgstr": ""}, ""
        for found in filter(None, map(_LINE.fullmatch, map(str.strip, lines))):
            field = found[1] or field
            entry[field] += ast.literal_eval(found[2])
        if entry["msgid"] and entry["msgstr"]:
            known[entry["msgctxt"] or _ANY, entry["msgid"]] = entry["msgstr"]
    return known


def _filled(text: str, values: dict[str, object]) -> str:
    if not values:
        return text
    return text.format(**{n: told(v) if isinstance(v, Sentence) else v for n, v in values.items()})


def duration(seconds: float) -> str:
    """About how long, in a word or two."""
    if seconds < 90.0:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60.0)
    return f"{minutes} min" if minutes < 90 else f"{minutes // 60} h {minutes % 60} min"


def register() -> None:
    """Hand the catalogues to Blender, each under the language that its file is named after."""
    catalogues = {file.stem: read_catalogue(file) for file in _LOCALE.glob("*.po")}
    bpy.app.translations.register(__package__, catalogues)


def unregister() -> None:
    """Take them back."""
    bpy.app.translations.unregister(__package__)
