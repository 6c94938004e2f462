# SPDX-License-Identifier: Apache-2.0
"""The recovered light as environment images, as lobes, as Sun lamps, and what tells its level.

A Sun lamp is a disc of even radiance, a lobe fades away from its axis. Two figures make them light
a surface alike: the irradiance on a surface that faces the lamp, and the mean of the cosine about
the axis, which for a cone of half-angle a is (1 + cos a) / 2.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import torch

from robir.evaluation.light_scores import RecoveredLight, load_light
from robir.export.textures import write_exr
from robir.jobs.paths import JobPaths, read_json, write_json
from robir.maths import spherical_gaussian as sg

ROWS = 512

# Widest lobe that is given as a lamp, radians. Behind an edge at distance d a shadow fades over d
# times the diameter: at 15 degrees over a quarter of the way, and nothing crisp is left that a lamp
# could keep. A narrow disc and a lobe of the same mean cosine differ by 4 % of the lamp at most
# anywhere in a straight shadow's border.
MAX_LAMP_DIAMETER = math.radians(15.0)


def export_light(paths: JobPaths) -> RecoveredLight:
    """Write environment.exr, light.json and, where there are suns, environment_without_sun.exr.

    The images are 512 x 1024, 32-bit, linear Rec.709, in Blender's world frame, and keep the energy
    of lobes that are narrower than their texels.
    """
    table = paths.stage("appearance") / "light.json"
    light = load_light(table)
    lamps = sun_lamps(light)
    write_json(paths.light, {**read_json(table), "sun_lamps": lamps})
    write_exr(paths.environment, light.environment(ROWS))
    if lamps:
        kept = np.ones(len(light.is_sharp), bool)
        kept[[lamp["lobe"] for lamp in lamps]] = False
        rest = replace(
            light, lobes=light.chosen(torch.from_numpy(kept)), is_sharp=light.is_sharp[kept]
        )
        write_exr(paths.environment_without_sun, rest.environment(ROWS))
    else:
        paths.environment_without_sun.unlink(missing_ok=True)
    return light


def sun_lamps(light: RecoveredLight) -> list[dict[str, Any]]:
    """The sharp lobes that are narrow enough for a Sun lamp, in the order of the lobes.

    "lobe": index into the lobes; "direction": unit, world, towards the light; "irradiance": linear
    Rec.709, of a surface that faces the lamp, radiance times steradian (Blender's strength of a Sun
    lamp, W/m2); "angular_diameter": of a disc with the lobe's mean cosine, radians.
    """
    sharpness = light.lobes.sharpness.double()
    diameter = 4.0 * torch.asin(torch.sqrt(1.0 - sg.mean_cosine(sharpness)))
    irradiance = sg.integral(light.lobes) * sg.cosine_shares(
        sharpness, torch.ones_like(sharpness)
    ).unsqueeze(-1)
    return [
        {
            "lobe": index,
            "direction": light.lobes.axis[index].tolist(),
            "irradiance": irradiance[index].tolist(),
            "angular_diameter": float(diameter[index]),
        }
        for index in np.flatnonzero(light.is_sharp).tolist()
        if diameter[index] <= MAX_LAMP_DIAMETER
    ]


def light_told(evidence: list[dict[str, Any]], of: str) -> list[dict[str, Any]]:
    """Estimates of how bright the light is ("level") or of its "hue", by evidence.json.

    A row an estimate, then all together, then a colour that the user knows, if any: "by"; "times",
    this light over that of the last row, or its red over its blue; "within", the factor of one
    standard deviation.
    """
    rows = [row for row in evidence if row["of"] == of]
    base = rows[-1]["value"] if rows and of == "level" else 0.0
    return [
        {
            "by": row["by"],
            "times": round(float(np.exp(row["value"] - base)), 3),
            "within": round(float(np.exp(row["deviation"])), 3),
        }
        for row in rows
    ]
