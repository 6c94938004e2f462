# SPDX-License-Identifier: Apache-2.0
"""The sky as metal mirrors it.

Diffuse surfaces tell little of single parts of the sky, and nothing of what lies below a table's
horizon; metal shows both, one direction to each view. Where metal is known, the soft lobes are
changed until it shows what the photographs show. What reaches the diffuse surfaces stays as it
was solved, and lobes that no metal mirrors stay as they are.

Batch letters: M observations of metal, K soft lobes, U samples.
"""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray

from robir.appearance.evidence.config import EvidenceConfig, MirroredSkyConfig
from robir.appearance.evidence.lobe_changes import Mirrored, changed
from robir.appearance.light.problem import Problem
from robir.appearance.light.solver import Light
from robir.appearance.material.gloss import Gloss
from robir.appearance.material.observed import looked_at


def sky_by_metal(
    problem: Problem, light: Light, gloss: Gloss, config: EvidenceConfig
) -> Light | None:
    """The light with the sky that metal mirrors.

    Args:
        problem: Scene under a tone curve, highlights included.
        light: Solved light.
        gloss: Specular material under it.
        config: What metal tells, and how freely lobes change.

    Returns:
        The light with other soft lobes; None where there is too little metal or nothing else, or a
        sky of one lobe.
    """
    rows = problem.scene.rows
    metal = rows[(gloss.metallic[rows] > 0.5) & problem.radiance.seen.numpy()[rows]]
    soft, asked = light.amplitudes.soft, config.mirrored_sky
    if len(metal) < asked.least_metal * len(rows) or len(soft) < 2:
        return None
    paint = rows[gloss.is_paint[rows]]
    before = light.irradiance(problem, paint).clamp(min=1e-6)
    kept = problem.scene.soft[paint] / before.T[:, :, None]
    mirrored = _mirrored(problem, light, gloss, metal, asked)
    if not len(paint) or mirrored is None:
        return None
    sky = changed(soft, mirrored, kept, asked.kept_error, config.lobe_changes)
    return light.with_sky(sky)


def _mirrored(
    problem: Problem,
    light: Light,
    gloss: Gloss,
    rows: NDArray[np.int64],
    config: MirroredSkyConfig,
) -> Mirrored | None:
    """Radiance that views of some metal samples (U,) show, and what it is made of.

    Views near a sun's highlight and clipped ones are left out; None if that leaves none.
    """
    dark = light.with_sky(torch.zeros_like(light.amplitudes.soft))
    parts = []
    for roughness in np.unique(gloss.roughness[rows]):
        own = rows[gloss.roughness[rows] == roughness]
        reflections, rays, shown, _ = looked_at(problem, dark, own)
        base = torch.from_numpy(gloss.metal[own])[torch.from_numpy(rays.sample)]
        suns = base * reflections.from_suns(rays, float(roughness))[:, 1]
        fixed = suns + base * reflections.from_sky(rays, float(roughness))[:, 1]
        lobes = (
            base[:, :, None]
            * reflections.from_lobes(rays, float(roughness), len(light.amplitudes.soft))[:, None]
        )
        whole = fixed + lobes @ light.amplitudes.soft.mean(1)
        clear = (suns < config.sun_share * whole).all(1) & ~shown.clipped.any(1)
        parts.append((shown.linear[clear], fixed[clear], lobes[clear]))
    seen, fixed, lobes = (torch.cat(column) for column in zip(*parts, strict=True))
    if not len(seen):
        return None
    error = config.shown_error * seen + config.least_error * seen.median(0).values
    freedom = config.base_freedom
    return Mirrored(seen=seen, fixed=fixed, lobes=lobes, error=error, base_freedom=freedom)
