# SPDX-License-Identifier: GPL-3.0-or-later
"""The recovered tone curve as the scene's view transform."""

from typing import Any

import bpy

from ..engine.sentences import Sentence
from ..words import told


def match_view_transform(scene: bpy.types.Scene, tone_curve: dict[str, Any]) -> tuple[str, ...]:
    """Show the scene as the photographs do; a sentence where this Blender has no such curve."""
    wanted, settings = tone_curve["blender_view_transform"], scene.view_settings
    settings.look = "None"
    settings.exposure = tone_curve["exposure"]
    try:
        settings.view_transform = wanted or "Standard"
    except TypeError:  # not in this Blender's list
        settings.view_transform, wanted = "Standard", None
    settings.gamma = _gamma(tone_curve) if wanted else 1.0
    if wanted:
        return ()
    return (
        Sentence(
            "the recovered tone curve ({family}) is none of Blender's view transforms: the "
            "viewport shows Standard; rendered files go through export/tone_curve.cube",
            family=tone_curve["family"],
        ),
    )


def view_transform_differs(scene: bpy.types.Scene, tone_curve: dict[str, Any]) -> bool:
    """Whether the scene is shown through another curve than the photographs."""
    settings, named = scene.view_settings, tone_curve["blender_view_transform"]
    if (settings.view_transform, settings.look) != (named or "Standard", "None"):
        return True
    gamma = _gamma(tone_curve) if named else 1.0
    distance = max(abs(settings.exposure - tone_curve["exposure"]), abs(settings.gamma - gamma))
    return distance > 1e-4


def view_name(tone_curve: dict[str, Any]) -> str:
    """The recovered curve in the terms of Blender's colour management."""
    named, gamma = tone_curve["blender_view_transform"], _gamma(tone_curve)
    if not named:
        return told("another curve")
    return named if gamma == 1.0 else told("{name} with gamma {gamma:g}", name=named, gamma=gamma)


def _gamma(tone_curve: dict[str, Any]) -> float:
    """Blender's gamma, which comes after the view transform; curves written earlier have none."""
    return tone_curve.get("blender_gamma", 1.0)
