# SPDX-License-Identifier: Apache-2.0
"""Pits that mirrored light has dug, filled again.

On polished metal every photograph shows another colour, and before the network has learnt what is
mirrored, a pit explains the photographs better than a smooth surface. Later gradients are weak
there and contradict each other, and the pit stays.
The network knows by then where colours change with the direction of view. There nothing is to be
dug that the masks do not demand, and hollows are filled, up to the visual hull. The next level
starts from the filled surface, with a network that knows reflections.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import max_pool3d, normalize

from robir.capture.camera import Camera
from robir.geometry.fit.field import ColourNetwork, Field
from robir.geometry.lattice import (
    Lattice,
    Sampled,
    interpolate,
    neighbour_mean,
    resample,
    smoothed,
)
from robir.maths.vectors import farthest_points

_NEAR = 0.7  # nodes so close to the surface are asked, each about the surface next to it (cells)
_LEAST_COSINE = 0.3  # between normal and view, from which a camera is asked
_LEAST_VIEWS = 4  # cameras that must face a spot
_MOST_VIEWS = 16  # cameras that are asked at all
# passes of the (1, 2, 1) / 4 filter over what single spots show: twelve make regions of five
# cells
_REGION_PASSES = 12
# mean change of display colour with the direction, over a region of the coarsest level, up to
# which nothing is filled: more than glossy paint shows
_DULL = 0.042
_MIRRORING = 0.05  # the same from which hollows are filled at full speed: less than metal shows
# as `dull` where photographs prove that something is mirrored: less than glossy paint shows. What
# is filled by it must let them predict each other better.
_PROVEN_DULL = 0.018
_PROVEN_MIRRORING = 0.026  # as `mirroring`, likewise
# share of the surface above which another light in some photographs, or cameras that are off, may
# be the cause instead of metal: then it must be proven
_MOST_MIRRORING = 0.25
# by which such a region is widened: a pit hides from the network what dug it; cells of the
# coarsest level
_REACH = 4
_ROUNDS = 200  # steps of the filling: 200 fill a hollow of nine cells across


def change_with_view(field: Field, network: ColourNetwork, cameras: list[Camera]) -> Tensor:
    """How much the fitted colour of a region changes with the direction of view, display units.

    The mean difference from the median over the cameras, of a region about each node (N,); 0 far
    from the surface. What hides the surface is not asked, for the network knows only directions.
    """
    lattice, sdf = field.lattice, field.sdf.detach()
    near = (sdf.abs() < _NEAR * lattice.cell).nonzero()[:, 0]
    points = lattice.nodes(str(sdf.device))[near]
    normals = normalize(field.gradient(points), dim=1, eps=1e-4)
    points = points - sdf[near, None] * normals
    index, weight = lattice.corners(points)
    with torch.no_grad():
        features = interpolate(field.features, field.row[index.long()], weight)
        shown = torch.full((len(cameras), len(near), 3), float("nan"), device=sdf.device)
        for own, camera in zip(shown, cameras, strict=True):
            eye = torch.from_numpy(camera.position).to(points)
            towards = normalize(eye - points, dim=1)
            cosine = (towards * normals).sum(1)
            facing = (cosine > _LEAST_COSINE).nonzero()[:, 0]
            own[facing] = network(features[facing], normals[facing], -towards[facing])
    apart = (shown - shown.nanmedian(0).values).abs().nanmean(dim=(0, 2))
    known = shown[..., 0].isfinite().sum(0) >= _LEAST_VIEWS
    total, count = (torch.zeros(lattice.count, device=sdf.device) for _ in range(2))
    total[near[known]], count[near[known]] = apart[known], 1.0
    total, count = (smoothed(values, lattice, _REGION_PASSES) for values in (total, count))
    return total / count.clamp(min=1e-6)


class SurfaceTest(Protocol):
    """What photographs say of surfaces."""

    def is_mirror(self, surface: Sampled) -> bool:
        """Whether they prove that a surface mirrors."""
        ...

    def is_better(self, surface: Sampled, other: Sampled) -> bool:
        """Whether the first surface explains them better than the other."""
        ...


class Mirroring:
    """Where a surface mirrors, as the coarsest level has learnt it, and what fills it.

    Finer levels learn highlights of glossy paint as well. The hull bounds what is filled.
    """

    def __init__(self, cameras: list[Camera], hull: Sampled, judge: SurfaceTest) -> None:
        positions = np.stack([camera.position for camera in cameras])
        self._cameras = [cameras[k] for k in farthest_points(positions, _MOST_VIEWS)]
        self._hull, self._test = hull, judge
        self._learnt: Sampled | None = None

    def filled(self, field: Field, network: ColourNetwork) -> Tensor:
        """Distances (N,), hollows that mirrored light has dug filled by a mean curvature flow."""
        lattice = field.lattice
        if self._learnt is not None:
            return self._filled(field, _at(self._learnt, lattice))
        change = change_with_view(field, network, self._cameras)
        share = _mirrors(change, _DULL, _MIRRORING)
        more = _mirrors(change, _PROVEN_DULL, _PROVEN_MIRRORING)
        speed, values = self._tried(field, share)
        if self._common(field, more) > 0.0:
            mirror = Sampled(lattice, values)
            if self._test.is_mirror(mirror):
                further = self._tried(field, more)
                if self._test.is_better(Sampled(lattice, further[1]), mirror):
                    speed, values = further
            elif self._common(field, share) > _MOST_MIRRORING:
                speed, values = self._tried(field, torch.zeros_like(share))
        self._learnt = Sampled(lattice, speed)
        return values

    def _tried(self, field: Field, share: Tensor) -> tuple[Tensor, Tensor]:
        """How fast (N,) in [0, 1] hollows are filled about what mirrors, and distances (N,)."""
        # off the surface a single spot may speak for a region: alone that is no metal
        if self._common(field, share) == 0.0:
            return torch.zeros_like(share), field.sdf.detach()
        grid, reach = share.view(field.lattice.shape)[None], _REACH
        share = max_pool3d(grid, 2 * reach + 1, stride=1, padding=reach).view(-1)
        return share, self._filled(field, share.view(field.lattice.shape))

    def _filled(self, field: Field, share: Tensor) -> Tensor:
        """Signed distances (N,) with hollows filled at the speed `share` (X, Y, Z) in [0, 1]."""
        lattice, before = field.lattice, field.sdf.detach()
        where = share.nonzero()
        if not len(where):
            return before
        sdf = before.clone().view(lattice.shape)
        low, high = where.amin(0).tolist(), where.amax(0).tolist()
        box = tuple(slice(max(a - 1, 0), b + 2) for a, b in zip(low, high, strict=True))
        part, share = sdf[box], share[box]
        least = torch.minimum(_at(self._hull, lattice)[box].to(part.device), part)
        for _ in range(_ROUNDS):
            step = (neighbour_mean(part) - part).clamp_(max=0.0)
            part.copy_(torch.maximum(part + share * step, least))
        return sdf.view(-1)

    def _common(self, field: Field, share: Tensor) -> float:
        """Mean share of the surface that mirrors."""
        near = _NEAR * field.lattice.cell
        return float(share[field.sdf.detach().abs() < near].mean())


def _mirrors(change: Tensor, low: float, high: float) -> Tensor:
    """How far regions mirror, (N,) in [0, 1], whose colours change so much with the view."""
    return ((change - low) / (high - low)).clamp_(0.0, 1.0)


def _at(values: Sampled, lattice: Lattice) -> Tensor:
    """Values of one lattice at the nodes of another, (X, Y, Z)."""
    return resample(values[1], values[0], lattice).view(lattice.shape)
