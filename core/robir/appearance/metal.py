# SPDX-License-Identifier: Apache-2.0
"""Which samples are metal, and the base colour and roughness of each metal part.

Polished metal shows its surroundings, displaced by every error of the mesh, so one sample's views
say little about its base colour. All views of a connected part together do: the median over them
of what is seen over what a white metal would show.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree
from torch import Tensor

from robir.appearance.reflections import Reflections, ViewRays

Floats = NDArray[np.float32]

METAL_ERROR = 0.03
"""Display error that a dielectric must leave before metal is thought of; those under a right mesh
leave 0.01 to 0.02."""

METAL_TOLERANCE = 40.0
"""How much worse than the dielectric a metal may fit, as a share per unit of display error beyond
METAL_ERROR: a mirror image is misplaced by the mesh's errors, but no dielectric changes so much."""

METAL_NEIGHBOURS = 16
"""Samples that judge together whether they are metal."""

METAL_GAP = 2.0
"""Gap, in spacings of the samples, across which metal samples belong to one part."""

METAL_PRIOR = 30
"""Samples that all metal of the scene counts as in the base colour of one part."""

DARKEST_METAL = 0.55
"""Brightest channel that every metal reaches at least: titanium, iron and chromium do."""

LIKELY_METAL = 0.6
"""Base colour towards which a part without any evidence tends."""


@dataclass(frozen=True, slots=True)
class MetalParts:
    """Connected metal parts.

    Attributes:
        part: (U,) part of every sample, -1 where it is no metal.
        base: (P, 3) base colour, linear Rec.709.
        roughness: (P,) perceptual.
    """

    part: NDArray[np.int64]
    base: Floats
    roughness: Floats


def metal_samples(dielectric: Floats, metal: Floats, points: Floats) -> NDArray[np.bool_]:
    """Samples whose neighbourhood is metal.

    Args:
        dielectric: (U, L) mean display error over each sample's views at every roughness.
        metal: (U, M) the same as metal.
        points: (U, D) positions, with scaled normals so that neighbours face alike.

    Returns:
        (U,) bool.
    """
    count = min(METAL_NEIGHBOURS, len(points))
    around = cKDTree(points).query(points, k=count)[1].reshape(len(points), count)
    best_dielectric = dielectric[around].mean(1).min(1)
    best_metal = metal[around].mean(1).min(1)
    excess = best_dielectric - METAL_ERROR
    allowed = best_dielectric * (1 + METAL_TOLERANCE * excess)
    is_metal = (excess > 0) & (best_metal < allowed)
    return is_metal[around].mean(1) > 0.5


def metal_parts(
    is_metal: NDArray[np.bool_],
    place: tuple[Floats, float],
    observed: tuple[Reflections, ViewRays, Tensor],
    errors: Floats,
    levels: tuple[float, ...],
) -> MetalParts:
    """Gather metal samples into parts and read what each is made of.

    Args:
        is_metal: (U,) bool.
        place: Positions (U, 3), unit frame, and their spacing.
        observed: What the samples reflect, their rays (M), and the radiance (M, 3) that is seen.
        errors: (U, L) mean display error of each sample as metal at every level.
        levels: The L roughnesses.

    Returns:
        The parts.
    """
    rows = np.flatnonzero(is_metal)
    part = np.full(len(is_metal), -1)
    if not len(rows):
        return MetalParts(part, np.zeros((0, 3), np.float32), np.zeros(0, np.float32))
    position, spacing = place
    tree = cKDTree(position[rows])
    near = tree.query_pairs(METAL_GAP * spacing, output_type="ndarray")
    links = coo_matrix((np.ones(len(near)), (near[:, 0], near[:, 1])), shape=(len(rows), len(rows)))
    count, part[rows] = connected_components(links, directed=False)
    reflections, rays, linear = observed
    number = part[rays.sample]
    best = [int(errors[part == index].mean(0).argmin()) for index in range(count)]
    ratios = np.zeros((len(number), 3), np.float32)
    for level in set(best):
        white = reflections.radiance(rays, levels[level])[:, 1].clamp(min=1e-5)
        chosen = np.isin(number, np.flatnonzero(np.array(best) == level))
        ratios[chosen] = (linear / white).numpy()[chosen]
    everywhere = np.log(np.median(ratios[number >= 0], axis=0).clip(0.05, 1.0))
    everywhere = 0.5 * (everywhere + np.log(LIKELY_METAL))
    base = np.zeros((count, 3), np.float32)
    for index in range(count):
        own = np.log(np.median(ratios[number == index], axis=0).clip(0.05, 1.0))
        weight = (part == index).sum() / ((part == index).sum() + METAL_PRIOR)
        mixed = np.exp(weight * own + (1 - weight) * everywhere)
        base[index] = mixed * max(1.0, DARKEST_METAL / mixed.max())
    return MetalParts(part, base, np.array([levels[k] for k in best], np.float32))
