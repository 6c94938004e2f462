# SPDX-License-Identifier: Apache-2.0
"""Photographs each in a light of its own.

Where clouds pass, a photographer or the arm of a robot stands before the lamps, or the object is
turned by hand, photographs of the same points differ by more than an exposure: what faces one way
is brighter, what faces another darker. To first order in the normal, which holds most of what a
light makes of a matt surface (Ramamoorthi and Hanrahan 2001),

    log linear(p, v) = point(p) + gain(v) + slope(v) . normal(p) + highlight or error,

solved by robust least squares. Sheen differs from view to view by orientation too, so slopes are
taken only where they account for much more of what photographs differ in than it does.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from robir.appearance.photometry.gains import (
    FEWEST_POINTS,
    halves,
    others_errors,
    solve_gains,
)
from robir.appearance.photometry.robust import Weighing
from robir.appearance.proof import Proof

Array = NDArray[np.float64]
Floats = NDArray[np.float32]

LEAST_SHARE = 0.15
"""Share of the photographs' squared differences that slopes must account for. Under one light gloss
feigned .00 on two captures and .10 on one with metal; other lights made .18 to .43 of it."""

PLACE = 0.15
"""Side of the cubes, scene radii, within which points err together."""


def solve_slopes(log: Array, normals: Floats) -> Array:
    """By how much each photograph is brighter on what faces one way than on what faces another.

    Args:
        log: (P, V, 3) natural logarithms of radiance, NaN where a view does not show a point; every
            point is shown by some view.
        normals: (P, 3) unit.

    Returns:
        (V, 3) log radiance per unit of the normal, alike in all channels, of mean 0 over the views:
        what all have in common is a property of the points.
    """
    known = np.isfinite(log[..., 0])
    values = np.nan_to_num(log).mean(2)
    basis = np.column_stack([np.ones(len(normals)), normals]).astype(np.float64)
    weighing = Weighing(known, normals)
    unknowns = np.zeros((log.shape[1], 4))
    for _ in weighing.rounds():
        unknowns, points = _least_squares(values, basis, weighing.weight, weighing.prior())
        weighing.renew(np.abs(values - basis @ unknowns.T - points[:, None]))
    return unknowns[:, 1:]


def _least_squares(values: Array, basis: Array, weight: Array, prior: float) -> tuple[Array, Array]:
    """Unknowns (V, K) of views and points (P,) whose sums are nearest to the values (P, V).

    The points are eliminated. What is common to all views is pinned to 0, see `solve_views`.

    Args:
        values: (P, V) log radiance.
        basis: (P, K) that a view's unknowns are multiplied with.
        weight: (P, V), 0 where a view does not show a point.
        prior: Weight with which every unknown is drawn to 0.
    """
    (count, views), size = weight.shape, basis.shape[1]
    mass = weight.sum(1)
    mean = (weight * values).sum(1) / mass
    spread = (weight[:, :, None] * basis[:, None]).reshape(count, views * size)
    system = -(spread / mass[:, None]).T @ spread
    own = np.einsum("pv,pi,pj->vij", weight, basis, basis)
    pin = np.trace(system) / len(system) ** 2
    system = system.reshape(views, size, views, size)
    each, kind = np.arange(views), np.arange(size)
    system[each, :, each] += own
    system[:, kind, :, kind] += abs(pin)
    system = system.reshape(views * size, views * size) + prior * np.eye(views * size)
    right = np.einsum("pv,pk->vk", weight * (values - mean[:, None]), basis)
    unknowns = np.linalg.solve(system, right.reshape(-1)).reshape(views, size)
    unknowns -= unknowns.mean(0)
    return unknowns, mean - (weight * (basis @ unknowns.T)).sum(1) / mass


def have_own_lights(log: Array, normals: Floats, positions: Floats) -> bool:
    """Whether photographs are each in a light of its own, by more than gloss feigns.

    Slopes of points in some places must let photographs predict those in others.

    Args:
        log: (P, V, 3) log radiance under a plain tone curve, without any falloff, NaN where a view
            does not show a point.
        normals: (P, 3) of the points.
        positions: (P, 3) of the points, unit frame.
    """
    place = np.unique(np.floor(positions / PLACE), axis=0, return_inverse=True)[1].reshape(-1)
    is_first = halves(place)[place]
    if min(is_first.sum(), (~is_first).sum()) < FEWEST_POINTS:
        return False
    plain, rich, groups = [], [], []
    for judged in (is_first, ~is_first):
        slopes = solve_slopes(log[~judged], normals[~judged])
        tilt = (normals @ slopes.T)[..., None]
        shown = log[judged]
        point, view = np.nonzero(np.isfinite(shown[..., 0]))
        groups.append(np.stack([view, place[judged][point]]))
        alike = solve_gains(log[~judged], normals[~judged])
        tilted = solve_gains(log[~judged] - tilt[~judged], normals[~judged])
        plain.append(others_errors(shown, alike)[point, view])
        rich.append(others_errors(shown, tilted + tilt[judged])[point, view])
    proof = Proof.of(
        np.concatenate(plain), np.concatenate(rich), tuple(np.concatenate(groups, axis=1))
    )
    return proof.is_given and proof.gain > LEAST_SHARE * (proof.plain / 255) ** 2
