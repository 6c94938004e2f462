# SPDX-License-Identifier: Apache-2.0
"""The sky as metal mirrors it.

Diffuse surfaces tell little of single parts of the sky, and nothing of what lies below a table's
horizon; metal shows both, one direction to each view. Where metal is known, the soft lobes are
changed until it shows what the photographs show. What reaches the diffuse surfaces stays as it
was solved, and lobes that no metal mirrors stay as they are.

Batch letters: M observations of metal, K soft lobes, U samples.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from robir.appearance.light.problem import Problem
from robir.appearance.light.solver import Light
from robir.appearance.material.gloss import Gloss
from robir.appearance.material.observed import looked_at

LEAST_SHARE = 0.08
"""Share of metal among the samples that is needed: the normals of little metal, mostly small and
bent, displace all that it mirrors."""

SUN_SHARE = 0.3
"""Share of a sun in what metal shows from which a view says nothing about the sky beside it."""

SHOWN_ERROR, LEAST_SHOWN = 0.3, 0.1
"""Error of what metal shows, as a share of it, and of the median of all views, that is added."""

ALIKE = 3.0
"""Views that count as one: errors of normals are common to many."""

KEPT_ERROR, KEPT_COUNT = 0.02, 30.0
"""Share by which the irradiance of paint may change, and samples that keep it, however many there
are: what was solved without the metal is not exact either."""

FREEDOM = 1.0
"""Usual change of the logarithm of a lobe."""

HUE_FREEDOM = 0.3
"""The same of its channels against their mean: gold mirrors hardly any blue."""

BASE_FREEDOM = 0.1
"""The same of the metal's base colour, which is read anew afterwards."""

MOST_STEP = 0.7
"""Most that a logarithm changes in one round."""

ROUNDS = 12


def sky_by_metal(problem: Problem, light: Light, gloss: Gloss) -> Light | None:
    """The light with the sky that metal mirrors.

    Args:
        problem: Scene under a tone curve, highlights included.
        light: Solved light.
        gloss: Specular material under it.

    Returns:
        The light with other soft lobes; None where there is too little metal or nothing else, or a
        sky of one lobe.
    """
    rows = problem.scene.rows
    metal = rows[(gloss.metallic[rows] > 0.5) & problem.radiance.seen.numpy()[rows]]
    soft = light.amplitudes.soft
    if len(metal) < LEAST_SHARE * len(rows) or len(soft) < 2:
        return None
    paint = rows[gloss.is_paint[rows]]
    before = light.irradiance(problem, paint).clamp(min=1e-6)
    kept = problem.scene.soft[paint] / before.T[:, :, None]
    mirrored = _mirrored(problem, light, gloss, metal)
    if not len(paint) or not len(mirrored[0]):
        return None
    changed = _changed(soft, mirrored, kept)
    return replace(light, amplitudes=replace(light.amplitudes, soft=changed))


def _mirrored(
    problem: Problem, light: Light, gloss: Gloss, rows: NDArray[np.int64]
) -> tuple[Tensor, Tensor, Tensor]:
    """Radiance that views of some metal samples (U,) show, and what it is made of.

    Returns:
        What is seen (M, 3), what of it suns and surfaces send (M, 3), and (M, 3, K) what each lobe
        of amplitude 1 sends. Views near a sun's highlight and clipped ones are left out.
    """
    dark = replace(
        light, amplitudes=replace(light.amplitudes, soft=torch.zeros_like(light.amplitudes.soft))
    )
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
        clear = (suns < SUN_SHARE * whole).all(1) & ~shown.clipped.any(1)
        parts.append((shown.linear[clear], fixed[clear], lobes[clear]))
    seen, fixed, lobes = (torch.cat(column) for column in zip(*parts, strict=True))
    return seen, fixed, lobes


def _prior(count: int) -> Tensor:
    """Inverse covariance of the changes: of each channel `count` lobes and the base colour."""
    mean = torch.full((3, 3), 1 / 3, dtype=torch.float64)
    unlike = torch.eye(3, dtype=torch.float64) - mean
    prior = torch.zeros(3, count + 1, 3, count + 1, dtype=torch.float64)
    lobe, channel = torch.arange(count), torch.arange(3)
    prior[:, lobe, :, lobe] = mean / FREEDOM**2 + unlike / HUE_FREEDOM**2
    prior[channel, -1, channel, -1] = BASE_FREEDOM**-2
    return prior.reshape(3 * count + 3, 3 * count + 3)


def _changed(soft: Tensor, mirrored: tuple[Tensor, Tensor, Tensor], kept: Tensor) -> Tensor:
    """Amplitudes (K, 3), by Gauss and Newton over their logarithms and those of the base colour.

    Args:
        soft: (K, 3) before.
        mirrored: Seen (M, 3), fixed (M, 3), and what lobes of amplitude 1 send (M, 3, K).
        kept: (3, U, K) share of the irradiance of diffuse samples that each amplitude sends.
    """
    seen, fixed, lobes = (part.double() for part in mirrored)
    soft = soft.double().clamp(min=1e-6)
    held = kept.double() * soft.T[:, None]
    error = SHOWN_ERROR * seen + LEAST_SHOWN * seen.median(0).values
    keeping = KEPT_COUNT / held.shape[1] / KEPT_ERROR**2
    count = len(soft)
    prior = _prior(count)
    change = torch.zeros(3, count + 1, dtype=torch.float64)
    for _ in range(ROUNDS):
        system, wanted = prior.clone(), -prior @ change.view(-1)
        for c in range(3):
            factor, base = change[c, :-1].exp(), change[c, -1].exp()
            now = lobes[:, c] * (soft[:, c] * factor)
            shown = base * (fixed[:, c] + now.sum(1))
            slope = torch.cat([base * now, shown[:, None]], 1) / error[:, c, None]
            off = (seen[:, c] - shown) / error[:, c]
            weight = 1 / (1 + off.square()) / ALIKE
            apart = held[c] * factor
            own = slice(c * (count + 1), (c + 1) * (count + 1))
            lobe = slice(own.start, own.stop - 1)
            system[own, own] += slope.T @ (weight[:, None] * slope)
            wanted[own] += slope.T @ (weight * off)
            system[lobe, lobe] += keeping * apart.T @ apart
            wanted[lobe] -= keeping * apart.T @ (apart - held[c]).sum(1)
        step = torch.linalg.solve(system, wanted).view(3, count + 1)
        change = change + step * min(1.0, MOST_STEP / float(step.abs().max().clamp(min=1e-9)))
    return (soft * change[:, :-1].exp().T).float()
