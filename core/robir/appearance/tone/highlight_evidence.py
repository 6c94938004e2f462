# SPDX-License-Identifier: Apache-2.0
"""How well a tone curve explains the highlights of the suns.

A highlight adds the same light to a dark material as to a bright one, at codes that diffuse light
alone does not reach, and how much it adds is known: paint reflects 4 % at normal incidence, and
the sun's strength against the sky's is known from its shadows. Under a wrong curve no roughness
makes highlights of that height and width.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from robir.appearance.blocks import Table, block_numbers, table_of
from robir.appearance.light.lobes import log_ratio
from robir.appearance.light.problem import Problem
from robir.appearance.light.solver import Light
from robir.appearance.material.gloss import SHARPEST_SKY
from robir.appearance.material.observed import diffuse_below, seen_along
from robir.appearance.material.reflections import Reflections, ViewRays, reflected_share, view_rays
from robir.appearance.material.segments import clusters

Floats = NDArray[np.floating[Any]]

# that are tried. The error grows on both sides of the right one as it does from the tip of a V, so
# that wider steps would favour whichever curve has its tip near one.
_ROUGHNESSES = (0.2, 0.3, 0.38, 0.46, 0.54, 0.61, 0.68, 0.75, 0.82, 0.9)
_NUM_SAMPLES = 1500  # samples that are looked at
_LEAST_VIEWS = 100  # views near a sun's mirror direction that these must have to say anything
_NUM_MATERIALS = 6  # groups of like albedo among them; each has one roughness


def highlight_tables(
    models: tuple[tuple[Problem, Light], tuple[Problem, Light]], seed: int
) -> tuple[Table, Table] | None:
    """Display errors near the mirror directions of the suns, by blocks of the surface.

    Every material has the one roughness that explains its highlights best. What is one material
    the first model says for all, or they would be judged by different groups.

    Args:
        models: One scene under two curves, and the light under each, of the same suns.
        seed: Of samples and materials.

    Returns:
        A table for each model; None where hardly any view is near a mirror direction.
    """
    problem, light = models[0]
    transport = problem.scene.transport
    rows = _near_mirrors(problem, light, np.random.default_rng(seed))
    if not len(rows):
        return None
    log_albedo = log_ratio(problem.rows_radiance(rows).linear, light.irradiance(problem, rows))
    material = clusters(log_albedo.numpy(), _NUM_MATERIALS, seed)
    block = block_numbers(transport.surfels.position[rows])
    directions = transport.visibility.directions
    rays = view_rays(transport.surfels, transport.observations, rows, directions)

    def table(model: tuple[Problem, Light]) -> Table:
        error, count = _errors(*model, rows, rays)
        best = np.zeros(len(rows))
        for index in range(material.max() + 1):
            own = material == index
            best[own] = error[own, error[own].sum(0).argmin()]
        return table_of(block, best / count.clip(1), count)

    return table(models[0]), table(models[1])


def _near_mirrors(problem: Problem, light: Light, rng: np.random.Generator) -> NDArray[np.int64]:
    """Some samples that a view sees near a sun's mirror direction; none if those views are few."""
    scene = problem.scene
    count = min(_NUM_SAMPLES, len(scene.rows))
    rows = np.sort(rng.choice(scene.rows, count, replace=False))
    transport = scene.transport
    directions = transport.visibility.directions
    rays = view_rays(transport.surfels, transport.observations, rows, directions)
    reflections = Reflections(problem, light, rows)
    near = rays.sample[reflections.near_highlight(rays).numpy()]
    return rows[np.unique(near)] if len(near) >= _LEAST_VIEWS else rows[:0]


def _errors(
    problem: Problem, light: Light, rows: NDArray[np.int64], rays: ViewRays
) -> tuple[Floats, Floats]:
    """Display errors (U, L) at every roughness, summed over views near highlights.

    And the number of those views, (U,).
    """
    reflections = Reflections(problem, light, rows)
    seen = seen_along(problem, rays, rows)
    valid = torch.from_numpy(problem.scene.transport.observations.weight[rows] > 0)
    near = reflections.near_highlight(rays)
    near_seen, sample = seen.of(near), torch.from_numpy(rays.sample)[near]
    blurred = reflections.from_sky(rays, SHARPEST_SKY)[:, 0]
    error = torch.zeros(len(_ROUGHNESSES), len(rows))
    for index, roughness in enumerate(_ROUGHNESSES):
        is_sharp = roughness < SHARPEST_SKY
        sky = blurred if is_sharp else reflections.from_sky(rays, roughness)[:, 0]
        specular = sky + reflections.from_suns(rays, roughness)[:, 0]
        through = 1 - reflected_share(rays, roughness)[:, None]
        diffuse = diffuse_below(seen, specular, through, (rays, valid))
        error[index].index_add_(0, sample, near_seen.error((diffuse + specular)[near]))
    count = np.bincount(sample.numpy(), minlength=len(rows)).astype(float)
    return error.T.double().numpy(), count
