# SPDX-License-Identifier: Apache-2.0
"""Scores of the recovered light and tone curve."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from skimage.transform import resize_local_mean

from robir.evaluation.light import LUMINANCE, RecoveredLight
from robir.maths import tone
from robir.maths.tone_curve import DISPLAY_POWER
from robir.maths.vectors import equirect_directions, equirect_solid_angles
from robir_bench.truth import metrics

Array = NDArray[np.floating[Any]]
_SCORE_ROWS = 64
_MAX_NORMALS = 500


def light_scores(
    light: RecoveredLight, truth_linear: Array, sun_direction: Array, normals: Array
) -> dict[str, float | None]:
    """Error of the recovered light.

    `truth_linear` (H, 2H, 3) is true lat-long radiance, lamps included, times the exposure, as the
    tone curve was given it; `sun_direction` (3,) points to the sun; `normals` (N, 3), unit, world,
    are what the test views show. "strongest_lobe_degrees": angle of the strongest sharp lobe to the
    sun, None without one; "environment_log_rmse" at 64 x 128 texels; "level_log_error" and
    "hue_log_error" of `level_and_hue`.
    """
    axis = light.strongest_direction()
    small = resize_local_mean(truth_linear, (_SCORE_ROWS, 2 * _SCORE_ROWS))
    ours = light.environment(_SCORE_ROWS)
    return {
        "strongest_lobe_degrees": (
            None if axis is None else metrics.direction_error(axis, sun_direction)
        ),
        "environment_log_rmse": metrics.environment_log_rmse(ours, small),
        **level_and_hue(ours, small, normals),
    }


def level_and_hue(estimate_linear: Array, truth_linear: Array, normals: Array) -> dict[str, float]:
    """How bright and of which hue the light is that falls on a surface, beside the true one.

    Of both maps (H, 2H, 3), lat-long radiance, the irradiance of unoccluded surfaces is averaged
    over normals (N, 3), unit, world, of which some hundreds are used: what the estimate has too
    much of here its albedo has too little of. "level_log_error": natural logarithm of the ratio of
    luminances, above 0 where the estimate is too bright; "hue_log_error": standard deviation over
    the channels of the logarithms of their ratios, 0 where the hue is right.
    """
    ours, true = (_mean_irradiance(image, normals) for image in (estimate_linear, truth_linear))
    return {
        "level_log_error": float(np.log((ours @ LUMINANCE) / (true @ LUMINANCE))),
        "hue_log_error": float(np.std(np.log(ours / true))),
    }


def _mean_irradiance(image: Array, normals: Array) -> Array:
    """Irradiance (3,) by a map (H, 2H, 3), averaged over normals (N, 3), above 0."""
    rows = image.shape[0]
    thinned = normals[:: len(normals) // _MAX_NORMALS + 1]
    solid = equirect_solid_angles(rows).numpy().reshape(-1, 1)
    directions = equirect_directions(rows).numpy().reshape(-1, 3)
    seen = np.maximum(thinned @ directions.T, 0.0).mean(axis=0)[:, None] * solid
    return np.maximum((seen * image.reshape(-1, 3)).sum(axis=0), 1e-9)


CODES = np.linspace(0.05, 0.95, 91)  # display codes at which curves are compared
_MEASURED = {"EMoR mean": "camera"}  # names in scene.json that Blender has not, and ours


def true_curve(scene: Mapping[str, Any]) -> tone.AbstractToneCurve | None:
    """The curve of a scene.json: "view_transform" and "display_power"; None if not of ours."""
    if scene.get("look"):
        return None
    name = _MEASURED.get(scene["view_transform"], scene["view_transform"])
    for curve in tone.families():
        if name in (curve.blender_view_transform, curve.name):
            return tone.powered(curve, float(scene.get(DISPLAY_POWER, 1.0)))
    return None


def stops_apart(curve: tone.AbstractToneCurve, other: tone.AbstractToneCurve) -> float:
    """Root mean square of the log2 ratio of two curves' radiance over CODES, without its mean."""
    ratio = np.log2(grey_radiance(curve) / grey_radiance(other))
    return float(ratio.std())


def grey_radiance(curve: tone.AbstractToneCurve) -> Array:
    """Grey radiance of each of CODES under a curve, at least 1e-6."""
    grey = torch.from_numpy(CODES)[:, None].expand(-1, 3)
    return curve.linear_from_display(grey).mean(-1).clamp_min(1e-6).numpy()


def tone_scores(found: Mapping[str, Any], scene: Mapping[str, Any]) -> dict[str, Any]:
    """Scores of tone_curve.json by the truth's scene.json; "stops" apart, None if not of ours."""
    truth = true_curve(scene)
    recovered = tone.curve_from_name(found["family"], found["parameters"])
    return {
        "family": found["family"],
        "parameters": found["parameters"],
        "true_view_transform": scene["view_transform"],
        "true_display_power": float(scene.get(DISPLAY_POWER, 1.0)),
        "stops": None if truth is None else stops_apart(recovered, truth),
    }
