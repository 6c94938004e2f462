# SPDX-License-Identifier: Apache-2.0
"""Height of a flat ground by its far edge.

Where a visual hull bulges, the touching point of an outline's ray is a guess, and a ground laid
through such guesses comes out high. Its edge itself is no guess: in a plane that is too high, flat
cameras see it nearer to the middle than steep ones do. So the height is sought at which all
photographs see one edge.

Batch letters: P rays, K knots of the edge.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robir.maths.vectors import tangents

Array = NDArray[np.float64]


# points between which the edge's distance from the middle is linear in the angle about it
_KNOTS = 36
_STIFFNESS = 0.3  # weight of the difference between neighbouring knots against one ray
# upward part of an outline's outward normal; upright things and near edges, below which the
# ground shows its side, have less
_LEAST_RISE = 0.3
_LEAST_FALL = 0.05  # downward part of a ray's direction; flatter ones meet the plane anywhere
# cosine between an outline's normal, within the plane, and the direction from the middle;
# outlines of what stands before the edge run across it
_LEAST_ALONG = 0.9
_ROUNDS = 10  # linear solutions
_WIDE_ROUNDS = 3  # how many of them take rays at the full width
_NARROWING = 0.35  # share of the width at which a ray counts as stray in the others
_RAYS_A_KNOT = 5  # rays that must agree on the edge, for each knot


@dataclass(frozen=True, slots=True)
class OutlineRays:
    """Rays through the outlines of masks, unit frame.

    Attributes:
        origins: (P, 3).
        directions: (P, 3) unit.
        outward: (P, 3) unit, across the ray and out of the mask: the normal of what it touches.
    """

    origins: Array
    directions: Array
    outward: Array


def level(
    rays: OutlineRays,
    touching: NDArray[np.int64],
    middle: Array,
    normal: Array,
    width: float,
) -> float:
    """How far to raise a plane so that all photographs see the same far edge in it.

    Linear least squares for the edge, for the rise and for the radius of a rounding of the edge,
    repeated with Geman-McClure weights.

    Args:
        rays: All outlines.
        touching: Numbers of those that are thought to touch the edge, to begin with.
        middle: (3,) point of the plane within the edge, unit frame.
        normal: (3,) unit normal of the plane, towards the cameras.
        width: How far a ray may miss the edge at first, and the plane move, unit frame.

    Returns:
        The rise, unit frame; 0 where too few rays agree on an edge or none is near.
    """
    weight = np.zeros(len(rays.origins))
    weight[touching] = 1.0
    knots, narrow = _KNOTS, _NARROWING * width
    system = _System(rays, middle, normal)
    edge = system.solve(weight)
    rise = edge[knots]
    for number in range(_ROUNDS):
        # the unknowns are those of the last height: the edge is the same, the rise is done
        edge[knots] = 0.0
        system = _System(rays, middle + rise * normal, normal)
        weight = system.weights(edge, width if number < _WIDE_ROUNDS else narrow)
        edge = system.solve(weight)
        rise += edge[knots]
    agreeing = (weight[system.usable] > 0.5).sum()
    return rise if agreeing > _RAYS_A_KNOT * knots and abs(rise) < width else 0.0


class _System:
    """What rays say of an edge in a plane, linear in the unknowns.

    The unknowns are the K distances of the edge from the middle, the rise of the plane, and the
    radius of the edge's rounding.

    Args:
        rays: Outlines P.
        middle: (3,) point of the plane.
        normal: (3,) unit.

    Attributes:
        usable: (P,) bool, rays that may touch a far edge.
    """

    def __init__(self, rays: OutlineRays, middle: Array, normal: Array) -> None:
        first, second = tangents(normal)
        rising = rays.outward @ normal
        falling = np.maximum(-(rays.directions @ normal), 0.5 * _LEAST_FALL)
        reach = ((rays.origins - middle) @ normal) / falling
        spot = rays.origins + reach[:, None] * rays.directions - middle
        along, aside = spot @ first, spot @ second
        self._radius = np.maximum(np.hypot(along, aside), 1e-9)
        across = (rays.outward * spot).sum(1) / self._radius
        self.usable = across > _LEAST_ALONG * np.sqrt(np.maximum(1.0 - rising**2, 0.0))
        self.usable &= (rising > _LEAST_RISE) & (falling > _LEAST_FALL)
        turn = (np.arctan2(aside, along) / (2.0 * np.pi)) % 1.0 * _KNOTS
        knot, part, row = turn.astype(int) % _KNOTS, turn % 1.0, np.arange(len(turn))
        self._matrix = np.zeros((len(turn), _KNOTS + 2))
        self._matrix[row, knot] = 1.0 - part
        self._matrix[row, (knot + 1) % _KNOTS] = part
        # a higher plane is met earlier
        self._matrix[:, _KNOTS] = (rays.directions * spot).sum(1) / (self._radius * falling)
        # a circle's tangent with normal (sin e, cos e) passes its topmost level (1 - cos e) / sin e
        # radii outside its middle
        self._matrix[:, _KNOTS + 1] = (1.0 - rising) / np.maximum(across, 0.05)

    def weights(self, edge: Array, width: float) -> Array:
        """Geman-McClure weights (P,) of the rays given the unknowns (K + 2,)."""
        away = (self._matrix @ edge - self._radius) / width
        return 1.0 / (1.0 + away**2) ** 2

    def solve(self, weight: Array) -> Array:
        """Unknowns (K + 2,) by least squares with weights (P,)."""
        root = np.sqrt(weight * self.usable)
        stiff = np.zeros((_KNOTS, _KNOTS + 2))
        stiff[:, :_KNOTS] = np.roll(np.eye(_KNOTS), 1, axis=1) - np.eye(_KNOTS)
        stiff[:, :_KNOTS] *= _STIFFNESS
        matrix = np.concatenate([root[:, None] * self._matrix, stiff])
        wanted = np.concatenate([root * self._radius, np.zeros(_KNOTS)])
        return np.linalg.lstsq(matrix, wanted, rcond=None)[0]
