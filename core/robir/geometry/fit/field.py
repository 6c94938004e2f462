# SPDX-License-Identifier: Apache-2.0
"""What the fit changes: a distance field on a lattice, colour features near it, a small network.

Batch letters: N nodes, A nodes with features, R rays, Q end points of intervals, C features.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from robir.geometry.fit.sampling import Intervals
from robir.geometry.lattice import Lattice, Sampled, interpolate, resample, smoothed, spread, taken
from robir.geometry.rays import RaySampler
from robir.maths.volume import log_survival_between, weights

# frequencies at which the mirrored direction is shown to the network as well (radians)
_OCTAVES = (2.0, 4.0, 8.0)
_WIDTH = 64  # units of a hidden layer
_BATCHES = 40  # batches of 2048 rays that are searched for missing parts


class ColourNetwork(nn.Module):
    """Display colour of a ray from its composited features, at least 3 of them a node.

    The first three features are the colour itself (before the sigmoid); a small network adds what
    depends on the view. It sees the mirrored viewing direction, so a highlight, which is a function
    of that direction, need not be explained by a pit in the surface; sines and cosines of it let
    the network follow what changes quickly (Tancik et al. 2020, "Fourier features let networks
    learn high frequency functions in low dimensional domains").
    """

    def __init__(self, features: int) -> None:
        super().__init__()
        width, self._octaves = _WIDTH, _OCTAVES
        self.layers = nn.Sequential(
            nn.Linear(features + 10 + 6 * len(self._octaves), width),
            nn.ReLU(inplace=True),
            nn.Linear(width, width),
            nn.ReLU(inplace=True),
        )
        self.last = nn.Linear(width, 3)
        nn.init.zeros_(self.last.weight)
        nn.init.zeros_(self.last.bias)

    def forward(self, features: Tensor, normals: Tensor, directions: Tensor) -> Tensor:
        """Display RGB (R, 3) of composited features (R, C), unit normals and directions (R, 3)."""
        cosine = (normals * directions).sum(1, keepdim=True)
        mirrored = directions - 2.0 * cosine * normals
        waves = [
            wave(octave * mirrored) for octave in self._octaves for wave in (torch.sin, torch.cos)
        ]
        inputs = torch.cat([features, normals, directions, mirrored, cosine, *waves], dim=1)
        return torch.sigmoid(features[:, :3] + self.last(self.layers(inputs)))


class Field:
    """Distance field and colour features of one level; both are leaves that require gradients.

    `sdf` (N,) are signed distances, unit frame, copied; `features` (A, C), of which row 0 stands
    for nodes without features; `row` (N,) int32 that of each node. `soft_passes` are passes of the
    (1, 2, 1) / 4 filter under which the network is told of the surface; none where no network is.
    """

    def __init__(self, lattice: Lattice, sdf: Tensor, features: int, soft_passes: int = 0) -> None:
        self.lattice = lattice
        self._soft_passes = soft_passes
        self.sdf = sdf.clone().requires_grad_()
        self.features = torch.zeros(1, features, device=sdf.device).requires_grad_()
        self.row = torch.zeros(lattice.count, dtype=torch.int32, device=sdf.device)
        self.soften()

    def soften(self) -> None:
        """Take the present surface, freed of its small lumps, as what the network is told of it.

        A lump turns the mirrored direction, so that the network cannot tell what is mirrored,
        and what it cannot tell digs the lump further.
        """
        # beyond the border the filter finds 0, which shortens gradients but does not turn them
        self._soft = smoothed(self.sdf.detach(), self.lattice, self._soft_passes)

    def place_features(self, wanted: Tensor) -> Tensor:
        """Give the wanted nodes (N,) bool features, keep those that have some, drop the others.

        Returns the old row (A,) int32 of each new row, 0 where it had none: those start at the
        mean.
        """
        nodes = wanted.nonzero()[:, 0]
        old = torch.cat([self.row.new_zeros(1), self.row[nodes]])
        values = self.features.detach()[old.long()]
        kept = old > 0
        values[~kept] = values[kept].mean(0) if bool(kept.any()) else 0.0
        self.features = values.requires_grad_()
        self.row.zero_()
        count = torch.arange(1, len(nodes) + 1, dtype=torch.int32, device=nodes.device)
        self.row[nodes] = count
        return old

    def refined(self, lattice: Lattice) -> Field:
        """The field on a finer lattice."""
        sdf = resample(self.sdf.detach(), self.lattice, lattice)
        finer = Field(lattice, sdf, 1, self._soft_passes)
        nodes = lattice.nodes(str(self.sdf.device))
        row = self.row[self.lattice.nearest(nodes)]
        wanted = (row > 0).nonzero()[:, 0]
        index, weight = self.lattice.corners(nodes[wanted])
        index = self.row[index.long()]
        # nodes without features must not pull the mean
        weight = torch.where(index > 0, weight, 0.0)
        weight = weight / weight.sum(1, keepdim=True).clamp(min=1e-6)
        values = interpolate(self.features.detach(), index, weight)
        finer.features = torch.cat([self.features.detach()[:1], values]).requires_grad_()
        finer.row[wanted] = torch.arange(1, len(wanted) + 1, dtype=torch.int32, device=nodes.device)
        return finer

    def gradient(self, points: Tensor) -> Tensor:
        """Gradient of the softened distance at points (P, 3), differences over two cells."""
        cell = self.lattice.cell
        offsets = cell * torch.eye(3, device=points.device)
        stacked = (points[None] + torch.cat([offsets, -offsets])[:, None]).reshape(-1, 3)
        value = self.lattice.trilinear(self._soft, stacked).view(6, -1)
        return ((value[:3] - value[3:]) / (2.0 * cell)).T

    @torch.no_grad()
    def looked_up(self, intervals: Intervals) -> tuple[Tensor, Tensor]:
        """Distances (Q,) and features (Q, C) at end points, leaves that require gradients."""
        index, weight = intervals.index, intervals.weight
        value = interpolate(self.sdf[:, None], index, weight)[:, 0]
        local = interpolate(self.features, taken(self.row, index), weight)
        return value.requires_grad_(), local.requires_grad_()

    def take_slopes(
        self, intervals: Sequence[Intervals], slopes: Sequence[Sequence[Tensor]]
    ) -> None:
        """Give the field the gradients of what was looked up, of several blocks of rays."""
        index, weight = (
            torch.cat(parts)
            for parts in zip(*((i.index, i.weight) for i in intervals), strict=True)
        )
        value, local = (torch.cat(parts) for parts in zip(*slopes, strict=True))
        self.sdf.grad = spread(len(self.sdf), index, weight, value[:, None])[:, 0]
        self.features.grad = spread(len(self.features), taken(self.row, index), weight, local)

    def render(
        self,
        intervals: Intervals,
        looked_up: tuple[Tensor, Tensor],
        network: ColourNetwork,
        rays: tuple[Tensor, Tensor],
        inv_std: float,
    ) -> tuple[Tensor, Tensor]:
        """Display RGB (R, 3) of what rays meet, and their coverage (R,), both in [0, 1].

        `looked_up` is what the field has at the end points of the packed intervals, see the method
        of that name; `rays` are origins and unit directions (R, 3); `inv_std` is NeuS' steepness, 1
        / unit frame.
        """
        (origins, directions), (value, local) = rays, looked_up
        ray = intervals.ray
        log_step = log_survival_between(value, inv_std) * intervals.joined
        weight = weights(log_step, intervals.first[:-1])
        coverage = torch.zeros(len(origins), device=weight.device).index_add(0, ray[:-1], weight)
        # half of an interval's light comes from either end
        share = 0.5 * (nn.functional.pad(weight, (0, 1)) + nn.functional.pad(weight, (1, 0)))
        with torch.no_grad():
            reached = torch.zeros_like(coverage).index_add(0, ray, share * intervals.distance)
            depth = reached / coverage.clamp(min=1e-4)
            points = origins + depth[:, None] * directions
            normals = nn.functional.normalize(self.gradient(points), dim=1, eps=1e-4)
        local = local * share[:, None]
        mixed = local.new_zeros(len(origins), local.shape[1]).index_add(0, ray, local)
        mixed = mixed / coverage.clamp(min=1e-4)[:, None]
        rgb = network(mixed, normals, directions)
        return rgb, coverage


def restore_missing(field: Sampled, hull: Tensor, sampler: RaySampler) -> Tensor:
    """Distances (N,) with what the fit lost although the masks show it, from the hull's (N,).

    A thin part that is smoothed away at a coarse level leaves no surface that a gradient could pull
    on. Rays inside the masks that meet nothing find it again.
    """
    lattice, sdf = field
    marked = torch.zeros(lattice.count, dtype=torch.bool, device=sdf.device)
    for _ in range(_BATCHES):
        origins, directions, target = sampler.draw(2048)
        solid = target[:, 3] > 0.95
        origins, directions = origins[solid], directions[solid]
        nodes = lattice.along(origins, directions, 1.4 * lattice.cell)
        nodes = nodes[(taken(sdf, nodes) >= 2.0 * lattice.cell).all(1)].view(-1)
        marked[nodes[hull[nodes] < 0.5 * lattice.cell]] = True
    return torch.where(lattice.dilated(marked, 2), torch.minimum(sdf, hull), sdf)
