# SPDX-License-Identifier: Apache-2.0
"""Pits that mirrored light has dug, filled again.

On polished metal every photograph shows another colour, and before the network has learnt what is
mirrored, a pit explains the photographs better than a smooth surface. Later gradients are weak
there and contradict each other, and the pit stays: the gold of a bottle lay three cells too deep.
The network knows by then where colours change with the direction of view. There nothing is to be
dug that the masks do not demand, and hollows are filled, up to the visual hull. The next level
starts from the filled surface, with a network that knows reflections.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import max_pool3d, normalize

from robir.capture.camera import Camera
from robir.geometry.fit.field import ColourNetwork, Field
from robir.geometry.fit.regularise import neighbour_mean, smoothed
from robir.geometry.lattice import Lattice, Sampled, interpolate, resample
from robir.maths.vectors import farthest_points

NEAR = 0.7
"""Nodes within so many cells of the surface are asked, each about the surface next to it."""

FACING = 0.3
"""Least cosine under which a camera is asked."""

LEAST_VIEWS, MOST_VIEWS = 4, 16
"""Cameras that must face a spot, and that are asked at all."""

REGION_PASSES = 12
"""Passes of the (1, 2, 1) / 4 filter over what single spots show: five cells across."""

DULL, MIRRORING = 0.042, 0.05
"""Mean change of display colour with the direction, over a region of the coarsest level, up to
which nothing is filled and from which hollows are filled at full speed: more than glossy paint
shows, less than metal."""

MOST_MIRRORING = 0.25
"""Share of the surface above which another light in some photographs, or cameras that are off, may
be the cause instead of metal, and what is mirrored must be proven."""

REACH = 4
"""Cells of the coarsest level by which such a region is widened: a pit hides from the network what
dug it."""

ROUNDS = 200
"""Steps of the filling: a hollow of nine cells across is filled."""


def change_with_view(field: Field, network: ColourNetwork, cameras: list[Camera]) -> Tensor:
    """How much the fitted colour of a region changes with the direction of view.

    Args:
        field: Fitted field.
        network: Its colour network.
        cameras: From where it is looked at; what hides the surface is not asked, for the network
            knows only directions.

    Returns:
        (N,) mean difference from the median over the cameras, display units, mean over a region
        about each node; 0 far from the surface.
    """
    lattice, sdf = field.lattice, field.sdf.detach()
    near = (sdf.abs() < NEAR * lattice.cell).nonzero()[:, 0]
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
            facing = ((towards * normals).sum(1) > FACING).nonzero()[:, 0]
            own[facing] = network(features[facing], normals[facing], -towards[facing])
    apart = (shown - shown.nanmedian(0).values).abs().nanmean(dim=(0, 2))
    known = shown[..., 0].isfinite().sum(0) >= LEAST_VIEWS
    total, count = (torch.zeros(lattice.count, device=sdf.device) for _ in range(2))
    total[near[known]], count[near[known]] = apart[known], 1.0
    total, count = (smoothed(values, lattice, REGION_PASSES) for values in (total, count))
    return total / count.clamp(min=1e-6)


class Mirroring:
    """Where a surface mirrors, as the coarsest level has learnt it, and what fills it.

    Finer levels learn highlights of glossy paint as well.

    Args:
        cameras: From where it may be looked at.
        hull: What bounds the surface, signed distances on their lattice.
        is_mirror: Tells of a filled field whether photographs prove that its surface mirrors.
    """

    def __init__(
        self, cameras: list[Camera], hull: Sampled, is_mirror: Callable[[Field], bool]
    ) -> None:
        positions = np.stack([camera.position for camera in cameras])
        self._cameras = [cameras[k] for k in farthest_points(positions, MOST_VIEWS)]
        self._hull, self._is_mirror = hull, is_mirror
        self._learnt: Sampled | None = None

    def filled(self, field: Field, network: ColourNetwork) -> Tensor:
        """Fill hollows of what mirrors, by one half of a mean curvature flow.

        Args:
            field: Fitted field; of the coarsest level at first.
            network: Its colour network.

        Returns:
            The new signed distances (N,).
        """
        if self._learnt is not None:
            return self._filled(field, _at(self._learnt, field.lattice))
        lattice = field.lattice
        share, is_common = self._share(field, network)
        filled = self._filled(field, share.view(lattice.shape))
        if is_common and not self._is_mirror(Field(lattice, filled, 1)):
            share, filled = torch.zeros_like(share), field.sdf.detach()
        self._learnt = Sampled(lattice, share)
        return filled

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
        for _ in range(ROUNDS):
            step = (neighbour_mean(part) - part).clamp_(max=0.0)
            part.copy_(torch.maximum(part + share * step, least))
        return sdf.view(-1)

    def _share(self, field: Field, network: ColourNetwork) -> tuple[Tensor, bool]:
        """How far every node's surroundings mirror, (N,) in [0, 1], and whether most do."""
        lattice = field.lattice
        change = change_with_view(field, network, self._cameras)
        share = ((change - DULL) / (MIRRORING - DULL)).clamp_(0.0, 1.0)
        # off the surface a single spot may speak for a region: alone that is no metal
        mirroring = float(share[field.sdf.detach().abs() < NEAR * lattice.cell].mean())
        if mirroring == 0.0:
            return torch.zeros_like(share), False
        grid = share.view(lattice.shape)[None]
        widened = max_pool3d(grid, 2 * REACH + 1, stride=1, padding=REACH).view(-1)
        return widened, mirroring > MOST_MIRRORING


def _at(values: Sampled, lattice: Lattice) -> Tensor:
    """Values of one lattice at the nodes of another, (X, Y, Z)."""
    return resample(values[1], values[0], lattice).view(lattice.shape)
