# SPDX-License-Identifier: GPL-3.0-or-later
"""What the user knows and photographs leave open, as settings of the engine's appearance stage."""

import json
from pathlib import Path
from typing import Any

from ..errors import RequestError, ResultError
from ..gateway import JobPaths, client
from ..result.importer import mark_of, read_run
from ..result.known import hide_spots, shape_of
from ..words import told

AUTOMATIC = "auto"  # the tone curve that the engine is to find itself
_SPOT = ("spot_texel", "spot_result", "spot_shape")
_DIGITS = 6  # decimals that a property's single precision holds


def known_of(settings: Any) -> tuple[str, ...]:
    """Items of `--set` by which the engine is told what the user knows; none for nothing."""
    items: dict[str, list[Any]] = {}
    if settings.tone_curve != AUTOMATIC:
        items["families"] = [settings.tone_curve]
    if settings.spot_result:
        items["white_point"] = _rounded((*settings.spot_texel, *settings.spot_albedo))
    if any(settings.sun):
        items["sun"] = _rounded(settings.sun)
    return tuple(f"appearance.{name}={json.dumps(value)}" for name, value in items.items())


def _rounded(values: tuple[float, ...]) -> list[float]:
    return [round(value, _DIGITS) for value in values]


def remember_spot(settings: Any, root: Path, texel: tuple[float, float]) -> None:
    """Keep a spot of known paint, v upwards, and which shape's texture it lies on."""
    settings.spot_texel = texel
    settings.spot_result, settings.spot_shape = mark_of(root), shape_of(root)


def forget_spot(settings: Any) -> None:
    """No spot is known any more; the colour stays for the next one."""
    hide_spots()
    for name in _SPOT:
        settings.property_unset(name)


def check_spot(settings: Any, request: client.Request) -> None:
    """Refuse to tell the engine of a spot that would lie elsewhere on the texture of the result."""
    if not settings.spot_result:
        return
    picked = Path(settings.spot_result)
    if mark_of(request.out) != settings.spot_result:
        raise RequestError(
            "the spot of known paint was picked on {name}; pick it on this result or forget it",
            name=picked.name,
        )
    try:
        preset = read_run(JobPaths(picked))["preset"]
    except ResultError:
        preset = ""
    if preset != request.preset or shape_of(picked) != settings.spot_shape:
        raise RequestError(
            "the spot of known paint lies on another shape than the one of this preset; forget "
            "the spot, reconstruct, and pick it again"
        )


def forget_former_spot(settings: Any, root: Path) -> list[str]:
    """Forget a spot whose shape a newer result has replaced; a sentence for the user."""
    if settings.spot_result != mark_of(root) or settings.spot_shape == shape_of(root):
        return []
    forget_spot(settings)
    return [told("The shape is another one now: pick the spot of known paint again")]
