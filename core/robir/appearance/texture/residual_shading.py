# SPDX-License-Identifier: Apache-2.0
"""Albedo freed of what errors of mesh, light and shadow edges leave in it.

Batch letters: N points, M nodes among them, K other nodes about a node.
"""

from __future__ import annotations

from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from robir.workers import blocks, num_workers, side_by_side

Floats = NDArray[np.float32]

CHUNK = 256  # nodes at a time, whose surroundings then stay in the processor's cache

_MESH_ERROR = 0.02  # length over which errors of the mesh's normals vary, unit frame
_REACH = 0.4  # how far the surroundings reach that a texel is compared with, unit frame
_COUNT = 128  # texels of these
_ROUNDS = 3  # how often texels are drawn together
_ALIKE_BRIGHTNESS = 0.25  # difference of log albedo within which texels may be one material
_ALIKE_HUE = 0.12  # the same in hue
# standard deviation of a texel's hue against that of its brightness: how much sun arrives, which
# nobody knows at a shadow's edge, changes the one more than the other
_HUE_DOUBT = 0.35
_LIFT = 0.35  # by how much surroundings may lift any texel (log albedo)
_LEAST_DOUBT = 0.03  # adds to the standard deviation of every log albedo where texels are weighed
_BLURRED = 12  # texels over which corrections are blurred at most


def with_normals(position: Floats, normal: Floats, scale: float) -> Floats:
    """Points (N, 6) that lie close together where positions do and unit normals face alike.

    Opposite normals count as 2 `scale` apart.
    """
    return np.concatenate([position, scale * normal], axis=1)


def most_albedo(albedo: Floats, reflected: Floats, disagreement: Floats) -> Floats:
    """Albedo (N, 3) that no surroundings may lift a texel above.

    Were none of its light reflected, all of it would be diffuse. To that comes what mesh and light
    may be wrong by: `disagreement` (N,), a deviation of log albedo, and `_LIFT`.
    """
    slack = np.exp(np.hypot(disagreement, _LIFT))[:, None]
    return (albedo * np.maximum(reflected, 1.0) * slack).astype(np.float32)


class Surroundings:
    """The texels about each, found once."""

    def __init__(self, points: Floats, step: int) -> None:
        """Of `points` (N, 6) from `with_normals`; every `step`-th stands for its neighbours."""
        self._nodes = np.arange(0, len(points), step)
        afar = np.arange(0, len(self._nodes), step)
        distance, index = nearest(points[self._nodes], points[self._nodes[afar]], _COUNT, _REACH)
        self._is_near, self._other = np.isfinite(distance), afar[index]
        distance, self._close = nearest(points, points[self._nodes], _BLURRED, 3 * _MESH_ERROR)
        weight = np.exp(-(distance**2) / (2 * _MESH_ERROR**2))
        self._share = weight / weight.sum(1, keepdims=True).clip(1e-9)

    def smoothed(self, albedo: Floats, unknown: Floats) -> Floats:
        """Albedo (N, 3) without what errors of mesh, light and shadow edges leave in it.

        Every texel is drawn towards the mean of what is like it in its wider surroundings, by
        inverse variances. Errors of the light change brightness more than hue, so likeness asks
        more of hue. The corrections, not the albedo, are then blurred: no error varies faster than
        the mesh's do, and finer texture stays. `unknown` (N,) is one standard deviation of the
        albedo's logarithm.
        """
        nodes, other = self._nodes, self._other
        before = smooth = np.log(albedo[nodes].T.astype(np.float32))
        doubt = unknown[nodes].astype(np.float32)
        certainty = 1 / (_LEAST_DOUBT + doubt) ** 2
        # not everything resembles the unknown
        wider = np.stack([doubt, np.minimum(_HUE_DOUBT * doubt, _ALIKE_HUE)])
        alike = np.array([[_ALIKE_BRIGHTNESS], [_ALIKE_HUE]], np.float32)
        width = 1 / (2 * (alike**2 + wider**2))
        known = self._is_near * certainty[other]
        parts = blocks(len(nodes), CHUNK)

        def drawn(smooth: Floats, rows: slice) -> Floats:
            own = (smooth[:, rows], certainty[rows], width[:, rows])
            return _drawn_together(own, smooth[:, other[rows]], known[rows])

        for _ in range(_ROUNDS):
            smooth = np.concatenate(side_by_side(partial(drawn, smooth), parts), axis=1)
        change = np.einsum("nk,nkc->nc", self._share, (smooth - before).T[self._close])
        return albedo * np.exp(change)


def _drawn_together(own: tuple[Floats, Floats, Floats], about: Floats, known: Floats) -> Floats:
    """Log albedo (3, M) of nodes, drawn towards those `about` them (3, M, K) that are alike."""
    # factors (2, M) are of squared differences in brightness and hue; `known` (M, K) is certainty
    log, certainty, width = own
    apart = about - log[..., None]
    grey = apart.sum(0) / 3
    alike = 3 * grey**2
    hue = (apart**2).sum(0) - alike
    weight = known * np.exp(-alike * width[0][:, None] - hue * width[1][:, None])
    around = np.einsum("nk,cnk->cn", weight, np.exp(about))
    return np.log((np.exp(log) * certainty + around) / (certainty + weight.sum(1)))


def nearest(
    points: Floats, others: Floats, count: int, reach: float
) -> tuple[Floats, NDArray[np.int64]]:
    """Distances and indices (N, count) of the nearest within reach; infinite, 0 beyond."""
    distance, index = cKDTree(others).query(
        points, count, eps=0.3, distance_upper_bound=reach, workers=num_workers()
    )
    missing = ~np.isfinite(distance)
    return distance.astype(np.float32), np.where(missing, 0, index)
