# SPDX-License-Identifier: GPL-3.0-or-later
"""The classes that a capture of the population belongs to."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from blender_scenes.format import ViewTruth
from blender_scenes.population.draw import Drawn

SUN_SHARE = 0.25
"""A sun counts as visible if it gives a surface that faces it this share of its light: below, the
shadow that it casts is a third darker than the light beside it at most."""

LOWEST_SUN_DEGREES = 5.0

METAL_SHARE = 0.02
"""Share of the object's pixels that must be of metal for the capture to have some."""


def classes(drawn: Drawn, scene: Mapping[str, Any], views: Sequence[ViewTruth]) -> dict[str, str]:
    """Name of a class by its kind: ground, paint, metal, tone, sun, backdrop, thing, cameras.

    Args:
        drawn: what was asked for.
        scene: contents of scene.json.
        views: the training views; an asset's metal is known from them alone.
    """
    recipe, tone = drawn.recipe, drawn.tone
    metallic = np.concatenate([view.metallic[view.hit > 0.5] for view in views])
    is_high = scene["sun_direction"][2] >= np.sin(np.radians(LOWEST_SUN_DEGREES)) - 1e-6
    return {
        "ground": "none" if recipe.ground is None else "ground",
        "paint": "patterned" if drawn.has_pattern else "plain",
        "metal": "metal" if (metallic > 0.5).mean() > METAL_SHARE else "no metal",
        "tone": tone.view_transform if tone.look is None else f"{tone.view_transform}, look",
        "sun": "sun" if scene["sun_share"] >= SUN_SHARE and is_high else "no sun",
        "backdrop": tone.backdrop or "alpha",
        "thing": drawn.thing,
        "cameras": recipe.cameras.kind,
    }
