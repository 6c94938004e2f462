# SPDX-License-Identifier: Apache-2.0
"""Detail that the mean of all photographs has lost, from the few that resolve a spot best.

Surface and cameras are a pixel off somewhere, so that no two photographs meet exactly, and the mean
of dozens has no speckles. The best four hold them. Albedo keeps the mean's colours over a few
texels, and within these takes their detail (multi-band blending, Burt and Adelson 1983) where

    r^2 = E[own^2] / E[d_i d_j],   i != j,

is small: of the detail that photographs i and j share the mean has lost most. Noise is not shared,
and what is drowned in it is shrunk by E[d_i d_j] / E[d^2] (Wiener 1949). Where the light changes
within these texels detail may be a shadow's edge; there albedo stays as it was solved.

Batch letters: N texels, A about each, K views a texel.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from robir.appearance.texture.detail import SharpestViews, agreed
from robir.appearance.texture.residual_shading import nearest, with_normals
from robir.appearance.texture.texels import MAX_ALBEDO, MIN_ALBEDO, TexelAlbedo
from robir.transport.surfels import interpolate
from robir.workers import num_workers

Floats = NDArray[np.float32]

_WIDTH = 4.0  # over which the mean's colours are kept (texels)
_PIXELS = 3.0  # the same where pixels are wider than texels
_MOST_WIDTH = 6.0  # beyond which it costs too much (texels)
_FACING = 4.0  # half of what opposite normals count as in the distance of two texels (texels)
_REACH = 2.5  # standard deviations of the mean over that width that are looked at
_EVERY = 5  # one texel in so many stands for its neighbours in the means of squared detail
_ABOUT = 48  # of these, over which the means are taken
# share of the contrast that is left, from which nothing is replaced, and below which all is: the
# fruit has lost most (median 0.28), a printed mouse keeps 0.41 and loses 0.3 dB, a house 0.60
_LEFT, _LOST = 0.45, 0.3
_UNSEEN = 0.03  # log contrast of detail at which half of it is taken: nobody sees less
_SHADOW = 0.05  # change of log irradiance within the width from which detail may be a shadow's


def regained(
    values: TexelAlbedo,
    where: tuple[NDArray[np.int32], Floats],
    views: SharpestViews,
    pixel: float,
) -> TexelAlbedo:
    """Values of solved texels with detail that the best photographs share and they lack.

    `where` is their face (N,) and barycentric coordinates (N, 3), and `pixel` the width of a
    photograph's pixel on the surface, unit frame.
    """
    if values.irradiance is None:
        raise RuntimeError("these texels are finer than light was solved for")
    texel = views.texel(len(where[0]))
    width = float(np.clip(_PIXELS * pixel / texel, _WIDTH, _MOST_WIDTH)) * texel
    position, normal = interpolate(views.mesh, *where)
    points = with_normals(position, normal, _FACING * texel)
    around = _Around.of(points, texel, width)
    own = around.detail(values.albedo)
    weights, shown = views.details(where, (texel, width))
    detail = agreed(weights, shown)
    count = (weights > 0).sum(1)
    told = count > 1
    # of all ordered pairs of photographs
    products = (shown.sum(1) ** 2).sum(1) - (shown**2).sum((1, 2))
    parts = (products, count * (count - 1), (detail**2).sum(1), (own**2).sum(1), 1)
    sums = _summed_about(points, [np.where(told, part, 0) for part in parts])
    shared = (sums[0] / np.maximum(sums[1], 1)).clip(1e-9)
    seen, solved = (part / np.maximum(sums[4], 1) for part in sums[2:4])
    left = np.sqrt(solved / shared)
    share = ((_LEFT - left) / (_LEFT - _LOST)).clip(0, 1)
    # twice, since a photograph's square reaches as far again as what is looked at here
    uneven = around.largest(around.largest(around.detail(values.irradiance))[:, None])
    share *= np.exp(-((uneven / _SHADOW) ** 2))
    share *= told & (values.metallic < 0.5)
    share *= shared / (shared + _UNSEEN**2)
    kept = (shared / seen.clip(1e-9)).clip(max=1)
    change = share[:, None] * (kept[:, None] * detail - own)
    albedo = (values.albedo * np.exp(change)).clip(MIN_ALBEDO, MAX_ALBEDO)
    return replace(values, albedo=albedo.astype(np.float32))


@dataclass(frozen=True, slots=True)
class _Around:
    """The texels about each, as a mean over a square of some width sees them."""

    index: NDArray[np.int64]  # (N, A)
    weight: Floats  # (N, A), rows sum to 1; 0 for what lies too far away

    @classmethod
    def of(cls, points: Floats, texel: float, width: float) -> _Around:
        """Of points (N, 6); a Gaussian of the variance by which the square exceeds a texel."""
        deviation = np.sqrt((width**2 - texel**2) / 12)
        count = min(len(points), int(4 * np.pi * (deviation / texel) ** 2) + 4)
        distance, index = cKDTree(points).query(
            points,
            count,
            eps=0.2,
            distance_upper_bound=_REACH * deviation,
            workers=num_workers(),
        )
        weight = np.exp(-(distance**2) / (2 * deviation**2)).astype(np.float32)
        index = np.where(weight > 0, index, 0)
        return cls(index, weight / weight.sum(1, keepdims=True))

    def detail(self, values: Floats) -> Floats:
        """Logs (N, 3) of positive values (N, 3) over their means about each texel."""
        mean = np.einsum("na,nac->nc", self.weight, values[self.index])
        return np.log(values.clip(1e-6)) - np.log(mean.clip(1e-6))

    def largest(self, detail: Floats) -> Floats:
        """(N,) largest of some detail (N, 3) about each texel."""
        return np.where(self.weight > 0, np.abs(detail).max(1)[self.index], 0).max(1)


def _summed_about(points: Floats, parts: list[NDArray[np.floating]]) -> list[Floats]:
    """Sums (N,) of some parts (N,) over the surroundings of points (N, 6)."""
    nodes = np.arange(0, len(points), _EVERY)
    about = nearest(points[nodes], points[nodes], min(_ABOUT, len(nodes)), np.inf)[1]
    own = nearest(points, points[nodes], 1, np.inf)[1]
    return [part[nodes][about.reshape(len(nodes), -1)].sum(1)[own] for part in parts]
