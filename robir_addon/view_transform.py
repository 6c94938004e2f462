# SPDX-License-Identifier: GPL-3.0-or-later
"""The recovered tone curve as the scene's view transform."""

from typing import Any

import bpy


def match_view_transform(scene: bpy.types.Scene, tone_curve: dict[str, Any]) -> tuple[str, ...]:
    """Show the scene as the photographs do.

    Args:
        scene: Scene whose colour management is set.
        tone_curve: Contents of tone_curve.json.

    Returns:
        A sentence where this Blender has no such curve.
    """
    wanted, settings = tone_curve["blender_view_transform"], scene.view_settings
    settings.look = "None"
    settings.gamma = 1.0
    settings.exposure = tone_curve["exposure"]
    try:
        settings.view_transform = wanted or "Standard"
    except TypeError:  # not in this Blender's list
        settings.view_transform, wanted = "Standard", None
    if wanted:
        return ()
    return (
        f"the recovered tone curve ({tone_curve['family']}) is none of Blender's view transforms: "
        "the viewport shows Standard; rendered files go through export/tone_curve.cube",
    )


def view_transform_differs(scene: bpy.types.Scene, tone_curve: dict[str, Any]) -> bool:
    """Whether the scene is shown through another curve than the photographs."""
    settings = scene.view_settings
    wanted = (tone_curve["blender_view_transform"] or "Standard", "None", 1.0)
    if (settings.view_transform, settings.look, settings.gamma) != wanted:
        return True
    return abs(settings.exposure - tone_curve["exposure"]) > 1e-4
