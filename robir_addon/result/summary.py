# SPDX-License-Identifier: GPL-3.0-or-later
"""What a result's report says, in sentences; read when the shown result changes, not when drawn."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import bpy
from bpy.app.handlers import persistent

from ..gateway import JobPaths, read_json
from ..relighting.pictures import read_pictures
from ..words import words

_DEVICES = {"cpu": "Processor", "cuda": "CUDA"}
_PRESETS = {"draft": "Draft", "standard": "Standard", "high": "High"}


@dataclass(frozen=True)
class Summary:
    """A report in words.

    Attributes:
        facts: How good the result is and where it came from, the most important first.
        choices: What the model chose, each with the reason.
        warnings: What to be careful about.
        brightness: How well the photographs tell it, which is among the facts as well; empty where
            the report does not say.
    """

    facts: tuple[str, ...]
    choices: tuple[tuple[str, str], ...]
    warnings: tuple[str, ...]
    brightness: str


_known: dict[str, Summary] = {}
"""What was read, by the result's absolute path; the shown results only."""


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
    choices = tuple(
        (f"{name.capitalize()}: {choice['chosen']}", str(choice["why"]))
        for name, choice in report["choices"].items()
    )
    doubts = (words("Not to be trusted: {doubt}", doubt=d) for d in report["trust"]["doubts"])
    told = (warning["message"] for warning in report["warnings"])
    warnings = (*doubts, *told, *report["missing"])
    return Summary(tuple(_facts(report)), choices, warnings, _brightness(report))


def _brightness(report: dict[str, Any]) -> str:
    levels = report.get("light_level")  # older results have none
    if not levels:
        return ""
    text = "Brightness of albedo known to a factor of {factor:.2f}"
    return words(text, factor=levels[-1]["within"])


def _facts(report: dict[str, Any]) -> list[str]:
    facts = []
    held_out, cycles = report["held_out"], report["cycles"]
    if held_out["psnr"] is not None:
        text = "{psnr:.1f} dB on {count} photographs kept aside"
        facts.append(words(text, psnr=held_out["psnr"], count=held_out["views"]))
    if cycles["psnr"] is not None:
        text = "{psnr:.1f} dB for Cycles on {count} of them"
        facts.append(words(text, psnr=cycles["psnr"], count=cycles["views"]))
    for sun in report["light"]["sharp"]:
        share, height = 100.0 * sun["power_share"], sun["elevation_degrees"]
        text = "Sun {height:.0f}\N{DEGREE SIGN} high: {share:.0f} % of the light"
        facts.append(words(text, height=height, share=share))
    facts += filter(None, [_brightness(report)])
    share, faces = 100.0 * report["seen_share"], report["mesh"]["faces"]
    facts.append(words("{share:.0f} % of the surface was seen", share=share))
    side = report["texture_size"]
    if tiles := report.get("tiles"):
        text = "{faces} triangles, textures of {count} tiles of {side} x {side}"
        facts.append(words(text, faces=faces, count=len(tiles), side=side))
    else:
        text = "{faces} triangles, textures of {side} x {side}"
        facts.append(words(text, faces=faces, side=side))
    minutes = sum(stage["wall"] for stage in report["seconds"].values()) / 60.0
    preset = _PRESETS.get(report["preset"]) or report["preset"].capitalize()
    device = _DEVICES.get(report["device"]) or report["device"]
    text = "{preset}, {device}, {minutes:.1f} minutes"
    facts.append(words(text, preset=words(preset), device=words(device), minutes=minutes))
    return facts


def register() -> None:
    """Follow what opens and what is undone."""
    for handlers in (bpy.app.handlers.load_post, *_undo_handlers()):
        handlers.append(_read_again)


def unregister() -> None:
    """Follow no longer."""
    for handlers in (bpy.app.handlers.load_post, *_undo_handlers()):
        handlers.remove(_read_again)
    _known.clear()


def _undo_handlers() -> tuple[list, list]:
    return bpy.app.handlers.undo_post, bpy.app.handlers.redo_post


@persistent
def _read_again(*_: object) -> None:
    read_shown()
