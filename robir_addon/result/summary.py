# SPDX-License-Identifier: GPL-3.0-or-later
"""What a result's report says, in sentences; read when the shown result changes, not when drawn."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import bpy

from ..gateway import JobPaths, read_json
from ..relighting.lights import read_pictures
from ..words import words
from .importer import active_result

_VERDICTS = {"Good": "Good", "Check this": "Check this", "Doubtful": "Doubtful"}


@dataclass(frozen=True)
class Summary:
    """A report in words; no reason where it is good, no brightness where the report has none."""

    verdict: str
    reason: str
    facts: tuple[str, ...]
    warnings: tuple[str, ...]
    brightness: str


# what was read, by the result's absolute path; the shown results only
_known: dict[str, Summary] = {}
_active: list[str] = []  # result of the object that was active last


def shown_summary(settings: bpy.types.PropertyGroup) -> Summary | None:
    """Summary of the result that is shown, if it has a report; touches no file."""
    return _known.get(bpy.path.abspath(settings.result))


def read_shown() -> None:
    """Read reports and light pictures of the results that the scenes show; forget the others."""
    shown = {bpy.path.abspath(scene.robir.result) for scene in bpy.data.scenes} - {""}
    read_pictures(shown)
    _known.clear()
    for result in shown:
        try:
            _known[result] = summary_of(read_json(JobPaths(Path(result)).report_json))
        except (OSError, ValueError, KeyError, TypeError, AttributeError):
            continue  # no report or a damaged one: the panel says that there is none


def summary_of(report: dict[str, Any]) -> Summary:
    """Summary of the contents of a report.json."""
    trust = report["trust"]
    verdict = trust["verdict"]
    sentences = filter(None, (verdict["reason"], verdict["remedy"]))
    reason = ". ".join(sentence[:1].upper() + sentence[1:] for sentence in sentences)
    told = (warning["message"] for warning in report["warnings"])
    warnings = (*trust["doubts"], *told, *report["missing"])
    word = words(_VERDICTS.get(verdict["word"]) or verdict["word"])
    return Summary(word, reason, tuple(_facts(report)), warnings, _brightness(report))


def _brightness(report: dict[str, Any]) -> str:
    levels = report.get("light_level")  # older results have none
    if not levels:
        return ""
    text = "Colours without light may be {factor:.1f} times too bright or dark"
    return words(text, factor=levels[-1]["within"])


def _facts(report: dict[str, Any]) -> list[str]:
    facts = []
    held_out = report["held_out"]
    if held_out["psnr"] is not None:
        text = "{count} held-out photographs are met to {psnr:.1f} dB (30: hard to tell apart)"
        facts.append(words(text, psnr=held_out["psnr"], count=held_out["views"]))
    facts += filter(None, [_brightness(report)])
    share, faces = 100.0 * report["seen_share"], report["mesh"]["faces"]
    facts.append(words("{share:.0f} % of the surface was photographed", share=share))
    side = report["texture_size"]
    if tiles := report.get("tiles"):
        text = "{faces} triangles, textures of {count} tiles of {side} x {side}"
        facts.append(words(text, faces=faces, count=len(tiles), side=side))
    else:
        text = "{faces} triangles, textures of {side} x {side}"
        facts.append(words(text, faces=faces, side=side))
    return facts


def _follow(*_: object) -> None:
    """Show the active object's result: the message bus misses clicks after a file was opened."""
    result = active_result(bpy.context)
    if [result] == _active:
        return
    _active[:] = [result]
    if result and bpy.path.abspath(bpy.context.scene.robir.result) != result:
        bpy.context.scene.robir.result = result


HANDLERS = (
    *((name, lambda *_: read_shown()) for name in ("load_post", "undo_post", "redo_post")),
    ("depsgraph_update_post", _follow),
)


def unregister() -> None:
    """Forget what was read."""
    _known.clear()
