# SPDX-License-Identifier: Apache-2.0
"""Reads the recovered light, and scores it and the recovered tone curve."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from skimage.transform import resize_local_mean

from robir.errors import StorageError
from robir.evaluation import metrics
from robir.evaluation.layers import stored_facts
from robir.jobs.records import NUMBERS
from robir.maths import spherical_gaussian as sg
from robir.maths import tone
from robir.maths.tone_curve import DISPLAY_POWER
from robir.maths.vectors import equirect_directions, equirect_solid_angles

Array = NDArray[np.floating[Any]]

_LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
_SCORE_ROWS = 64
_CHUNK_ROWS = 64
_MAX_NORMALS = 500
_LIGHT = {"lobes": [{"axis": NUMBERS, "sharpness": float, "amplitude": NUMBERS, "kind": str}]}


@dataclass(frozen=True, slots=True, kw_only=True)
class RecoveredLight:
    """The lobes of light.json."""

    lobes: sg.SphericalGaussians  # world-space mixture; amplitude is radiance, linear Rec.709
    is_sharp: NDArray[np.bool_]  # (K,) bool, suns and lamps as opposed to sky

    def power(self) -> Array:
        """Luminance of each lobe integrated over the sphere, (K,)."""
        return sg.integral(self.lobes).numpy() @ _LUMINANCE

    def strongest_direction(self) -> Array | None:
        """Axis (3,) of the sharp lobe of the greatest power, or None without sharp lobes."""
        if not self.is_sharp.any():
            return None
        strongest = int(np.argmax(np.where(self.is_sharp, self.power(), -np.inf)))
        return self.lobes.axis[strongest].numpy()

    def environment(self, rows: int) -> NDArray[np.float32]:
        """Lat-long image (rows, 2 rows, 3) in Blender's world frame, linear Rec.709 radiance.

        Lobes wider than four texels are evaluated at the texels' centres (energy to 1 in 1000);
        narrower ones are integrated over the texels, which keeps all of their energy.
        """
        wide = self.lobes.sharpness < (rows / (4 * np.pi)) ** 2
        image = np.empty((rows, 2 * rows, 3), np.float32)
        directions = equirect_directions(rows)
        for start in range(0, rows, _CHUNK_ROWS):
            part = slice(start, start + _CHUNK_ROWS)
            image[part] = sg.evaluate(self.chosen(wide), directions[part]).numpy()
        if not bool(wide.all()):
            image += sg.to_equirect(self.chosen(~wide), rows).numpy()
        return image

    def chosen(self, which: torch.Tensor) -> sg.SphericalGaussians:
        """Some of the lobes."""
        axis, sharpness, amplitude = self.lobes.axis, self.lobes.sharpness, self.lobes.amplitude
        parts = {"axis": axis[which], "sharpness": sharpness[which], "amplitude": amplitude[which]}
        return sg.SphericalGaussians(**parts)


def load_light(path: Path) -> RecoveredLight:
    """Read a light.json, or a `StorageError`."""
    table = stored_facts(path, _LIGHT)["lobes"]
    if any(len(lobe["axis"]) != 3 or len(lobe["amplitude"]) != 3 for lobe in table):
        fault = "an axis or amplitude has not three numbers"
        raise StorageError(f"{path} is damaged ({fault}); reconstruct with --resume")

    def column(name: str) -> torch.Tensor:
        return torch.tensor([lobe[name] for lobe in table], dtype=torch.float32)

    return RecoveredLight(
        lobes=sg.SphericalGaussians(
            axis=column("axis").reshape(-1, 3),
            sharpness=column("sharpness"),
            amplitude=column("amplitude").reshape(-1, 3),
        ),
        is_sharp=np.array([lobe["kind"] == "sharp" for lobe in table], bool),
    )


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
        "level_log_error": float(np.log((ours @ _LUMINANCE) / (true @ _LUMINANCE))),
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
