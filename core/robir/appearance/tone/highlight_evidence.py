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
from robir.appearance.material.observed import diffuse_below, seen_along
from robir.appearance.material.reflections import Reflections, ViewRays, reflected_share, view_rays
from robir.appearance.material.segments import clusters

Floats = NDArray[np.floating[Any]]


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
    config, transport = problem.scene.config, problem.scene.transport
    rows = _near_mirrors(problem, light, np.random.default_rng(seed))
    if not len(rows):
        return None
    log_albedo = log_ratio(problem.rows_radiance(rows).linear, light.irradiance(problem, rows))
    material = clusters(log_albedo.numpy(), config.tone.highlight_evidence.num_materials, seed)
    block = block_numbers(transport.surfels.position[rows], config.blocks)
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
    scene, asked = problem.scene, problem.scene.config.tone.highlight_evidence
    count = min(asked.num_samples, len(scene.rows))
    rows = np.sort(rng.choice(scene.rows, count, replace=False))
    transport = scene.transport
    directions = transport.visibility.directions
    rays = view_rays(transport.surfels, transport.observations, rows, directions)
    reflections = Reflections(problem, light, rows)
    near = rays.sample[reflections.near_highlight(rays).numpy()]
    return rows[np.unique(near)] if len(near) >= asked.least_views else rows[:0]


def _errors(
    problem: Problem, light: Light, rows: NDArray[np.int64], rays: ViewRays
) -> tuple[Floats, Floats]:
    """Display errors (U, L) at every roughness, summed over views near highlights.

    And the number of those views, (U,).
    """
    config = problem.scene.config
    statistics, sharpest_sky = config.photometry.statistics, config.material.gloss.sharpest_sky
    roughnesses = config.tone.highlight_evidence.roughnesses
    reflections = Reflections(problem, light, rows)
    seen = seen_along(problem, rays, rows)
    valid = torch.from_numpy(problem.scene.transport.observations.weight[rows] > 0)
    near = reflections.near_highlight(rays)
    near_seen, sample = seen.of(near), torch.from_numpy(rays.sample)[near]
    blurred = reflections.from_sky(rays, sharpest_sky)[:, 0]
    error = torch.zeros(len(roughnesses), len(rows))
    for index, roughness in enumerate(roughnesses):
        is_sharp = roughness < sharpest_sky
        sky = blurred if is_sharp else reflections.from_sky(rays, roughness)[:, 0]
        specular = sky + reflections.from_suns(rays, roughness)[:, 0]
        through = 1 - reflected_share(rays, roughness)[:, None]
        diffuse = diffuse_below(seen, specular, through, (rays, valid), statistics)
        error[index].index_add_(0, sample, near_seen.error((diffuse + specular)[near]))
    count = np.bincount(sample.numpy(), minlength=len(rows)).astype(float)
    return error.T.double().numpy(), count
