# SPDX-License-Identifier: Apache-2.0
"""Photographs each in a light of its own.

Where clouds pass, somebody stands before the lamps, or the object is turned by hand, what faces one
way is brighter and another darker. To first order in the normal, which holds most of what a light
makes of a matt surface (Ramamoorthi and Hanrahan 2001),

    log linear(p, v) = point(p) + gain(v) + slope(v) . normal(p) + highlight or error

is solved by robust least squares. A specular layer under one light does the like, but is one
function of the mirrored direction; slopes must also predict better than that.
"""

from __future__ import annotations

from itertools import product

import numpy as np
from numpy.typing import NDArray

from robir.appearance.held_out_test import HeldOutTest
from robir.appearance.photometry.gains import (
    FIRST_WIDTH,
    LAST_WIDTH,
    LEAST_POINTS,
    NARROWING,
    Weighing,
    halves,
    others_errors,
    solve_gains,
)

Array = NDArray[np.float64]
Floats = NDArray[np.float32]

_PLACE_SIZE = 0.15  # side of the cubes within which points err together (unit frame)
# of the rival specular reflection's polynomials: of the second, a ball with a Phong exponent of 8
# passes for one in lights of its own
_SPECULAR_DEGREE = 3
_SPECULAR_ROUNDS = 8  # turns of points and specular reflection
# weight of the specular reflection's prior against the trace of its equations
_SPECULAR_RIDGE = 1e-4

# share of the median squared error that slopes may leave: a light of its own changes most of a
# surface, a highlight or a wrong mesh few places, but these a lot. On a carton turned by hand 0.64
# is left, on two metal tins 0.92 and 1.06
_MOST_LEFT = 0.75


def solve_slopes(log: Array, normals: Floats) -> Array:
    """Log radiance (V, 3) per unit of the normal, alike in all channels, of mean 0 over the views.

    Arguments as for `solve_gains`; what all views have in common is a property of the points.
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
    """Unknowns (V, K) of views, times `basis` (P, K), and points (P,), nearest to values (P, V)."""
    # points are eliminated; what is common to all views is pinned to 0, see `solve_views`
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


def have_own_lights(log: Array, normals: Floats, places: tuple[Floats, Floats]) -> bool:
    """Whether photographs are each in a light of its own; of the same log radiance as `real_share`.

    Slopes of points in some places must let photographs predict those in others better than gains
    alone and better than a specular layer under one light. `places` are those of the points (P, 3)
    and of the cameras (V, 3), unit frame.
    """
    positions, cameras = places
    cells = np.floor(positions / _PLACE_SIZE)
    place = np.unique(cells, axis=0, return_inverse=True)[1].reshape(-1)
    is_first = halves(place)[place]
    if min(is_first.sum(), (~is_first).sum()) < LEAST_POINTS:
        return False
    mirrored = _mirrored(positions, normals, cameras, _SPECULAR_DEGREE)
    groups: list[NDArray[np.int64]] = []
    errors: list[list[Array]] = []
    for tested in (is_first, ~is_first):
        fitted, shown = ~tested, log[tested]
        point, view = np.nonzero(np.isfinite(shown[..., 0]))
        groups.append(np.stack([view, place[tested][point]]))
        specular = mirrored @ _solve_specular(log[fitted], normals[fitted], mirrored[fitted])
        slopes = normals @ solve_slopes(log[fitted], normals[fitted]).T
        errors.append([])
        for more in (np.zeros_like(specular), specular, slopes):
            added = more[..., None]
            gains = solve_gains(log[fitted] - added[fitted], normals[fitted])
            errors[-1].append(others_errors(shown, gains + added[tested])[point, view])
    plain, with_specular, own = (np.concatenate(both) for both in zip(*errors, strict=True))
    grouped = tuple(np.concatenate(groups, axis=1))
    if np.median(own) > _MOST_LEFT * min(np.median(plain), np.median(with_specular)):
        return False
    return all(
        HeldOutTest.of(simpler, own, grouped).is_passed for simpler in (plain, with_specular)
    )


def _mirrored(positions: Floats, normals: Floats, cameras: Floats, degree: int) -> Array:
    """Polynomials (P, V, K) of where points mirror each camera to: spherical harmonics."""
    towards = cameras[None] - positions[:, None].astype(np.float64)
    towards /= np.linalg.norm(towards, axis=2, keepdims=True)
    facing = np.einsum("pvi,pi->pv", towards, normals)
    x, y, z = np.moveaxis(2 * facing[..., None] * normals[:, None] - towards, -1, 0)
    powers = product(range(degree + 1), range(degree + 1), range(2))
    return np.stack([x**a * y**b * z**c for a, b, c in powers if 0 < a + b + c <= degree], axis=-1)


def _solve_specular(log: Array, normals: Floats, mirrored: Array) -> Array:
    """Coefficients (K,) of a specular layer under one light, by points and gains in turns."""
    known = np.isfinite(log[..., 0])
    gray = np.nan_to_num(log).mean(2)
    specular, width = np.zeros(mirrored.shape[2]), FIRST_WIDTH
    for _ in range(_SPECULAR_ROUNDS):
        shown = mirrored @ specular
        left = gray - shown - solve_gains(log - shown[..., None], normals).mean(1)
        left = np.where(known, left, 0.0)
        apart = left - left.sum(1, keepdims=True) / known.sum(1, keepdims=True)
        weight = known / (1 + (apart / width) ** 2) ** 2
        width = max(LAST_WIDTH, NARROWING * width)
        mass = weight.sum(1)
        kinds = mirrored - (np.einsum("pv,pvk->pk", weight, mirrored) / mass[:, None])[:, None]
        left = left - (weight * left).sum(1, keepdims=True) / mass[:, None]
        system = np.einsum("pv,pvk,pvl->kl", weight, kinds, kinds)
        right = np.einsum("pv,pvk,pv->k", weight, kinds, left)
        specular = specular + np.linalg.solve(
            system + _SPECULAR_RIDGE * np.trace(system) * np.eye(len(right)), right
        )
    return specular
