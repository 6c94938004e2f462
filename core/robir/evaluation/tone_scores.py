# SPDX-License-Identifier: Apache-2.0
"""The recovered tone curve against the one that the photographs went through."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from robir.maths import tone
from robir.maths.tone_power import DISPLAY_POWER

Array = NDArray[np.floating[Any]]

# display codes at which curves are compared: nearly all of a photograph
CODES = np.linspace(0.05, 0.95, 91)


# names of scene.json for curves that are no view transform of Blender, and ours for them
_MEASURED = {"EMoR mean": "camera"}


def true_curve(scene: Mapping[str, Any]) -> tone.AbstractToneCurve | None:
    """The curve that a scene.json names, or None if it is none of ours.

    "view_transform" is a view transform of Blender or a family of ours, "display_power" is there
    where the photographs were re-toned afterwards, and "look" where a look of Blender's came first,
    which makes it none of ours.
    """
    if scene.get("look"):
        return None
    name = _MEASURED.get(scene["view_transform"], scene["view_transform"])
    for curve in tone.families():
        if name in (curve.blender_view_transform, curve.name):
            return tone.powered(curve, float(scene.get(DISPLAY_POWER, 1.0)))
    return None


def stops_apart(curve: tone.AbstractToneCurve, other: tone.AbstractToneCurve) -> float:
    """Root mean square over CODES of the log2 ratio of what two curves take a code for.

    The mean ratio is left out: it is exposure, which no tone curve holds.
    """
    ratio = np.log2(grey_radiance(curve) / grey_radiance(other))
    return float(ratio.std())


def grey_radiance(curve: tone.AbstractToneCurve) -> Array:
    """Grey radiance of each of CODES under a curve, at least 1e-6."""
    grey = torch.from_numpy(CODES)[:, None].expand(-1, 3)
    return curve.linear_from_display(grey).mean(-1).clamp_min(1e-6).numpy()


def tone_scores(found: Mapping[str, Any], scene: Mapping[str, Any]) -> dict[str, Any]:
    """Scores of a recovered curve, by the contents of tone_curve.json and the truth's scene.json.

    "family" and "parameters" as recovered, "true_view_transform", "true_display_power", and
    "stops": how far the curves lie apart, None where the true one is none of ours.
    """
    truth = true_curve(scene)
    recovered = tone.curve_from_name(found["family"], found["parameters"])
    return {
        "family": found["family"],
        "parameters": found["parameters"],
        "true_view_transform": scene["view_transform"],
        "true_display_power": float(scene.get(DISPLAY_POWER, 1.0)),
        "stops": None if truth is None else stops_apart(recovered, truth),
    }
