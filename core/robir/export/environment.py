# SPDX-License-Identifier: Apache-2.0
"""The recovered light as an environment image and as lobes."""

from __future__ import annotations

from robir.evaluation.light import RecoveredLight, load_light
from robir.export.textures import write_exr
from robir.jobs.paths import JobPaths, read_json, write_json

ROWS = 512


def export_light(paths: JobPaths) -> RecoveredLight:
    """Write environment.exr and light.json.

    The image is 512 x 1024, 32-bit, linear Rec.709, in Blender's world frame, and keeps the energy
    of lobes that are narrower than its texels.
    """
    table = paths.stage("appearance") / "light.json"
    light = load_light(table)
    write_json(paths.light, read_json(table))
    write_exr(paths.environment, light.environment(ROWS))
    return light
