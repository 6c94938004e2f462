# SPDX-License-Identifier: Apache-2.0
"""NeuS: a signed distance network fitted to photographs by volume rendering.

Opacity comes from the distances at both ends of an interval (NeuS Eq. 13, `robir.maths.volume`),
so that gradients are needed only where colour is. Points that no pixel sees are searched without
gradients; what contributes is evaluated again with them.

Batch letters: R rays, S samples of a ray, P samples that contribute.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor, nn

from robir.capture.capture import View
from robir.errors import QualityError
from robir.geometry.rays import reduce_view
from robir.maths import volume
from robir_bench.paper.config import NeusConfig
from robir_bench.paper.networks import RadianceNetwork, SdfNetwork

SPHERE = 1.05  # radius within which the scene lies; rays are sampled inside it

EIKONAL_WEIGHT = 0.1
MASK_WEIGHT = 1.0

_SEARCH_STEEPNESS = 64.0
_LEAST_WEIGHT = 1e-3
_FREE_POINTS = 256


class PhotoRays:
    """All pixels of the training photographs as rays with codes.

    Attributes:
        count: How many.
        inside: Indices of those that lie wholly in a mask.
    """

    def __init__(self, views: tuple[View, ...], side: int) -> None:
        """Take photographs reduced to a longest side, unit frame."""
        origins, directions, codes, coverage = [], [], [], []
        for photo in (reduce_view(view, side) for view in views):
            origin, direction = photo.camera.rays(photo.camera.pixel_centres())
            origins.append(origin.astype(np.float32))
            directions.append(direction.astype(np.float32))
            cover = photo.coverage.reshape(-1)
            straight = photo.premultiplied_display.reshape(-1, 3) / np.maximum(cover, 1e-3)[:, None]
            codes.append(straight.clip(0.0, 1.0))
            coverage.append(cover)
        self._origins = torch.from_numpy(np.concatenate(origins))
        self._directions = torch.from_numpy(np.concatenate(directions))
        self._codes = torch.from_numpy(np.concatenate(codes))
        self._coverage = torch.from_numpy(np.concatenate(coverage))
        self.count = len(self._coverage)
        self.inside = torch.nonzero(self._coverage > 0.98)[:, 0]

    def rays(self, index: Tensor) -> tuple[Tensor, Tensor]:
        """Origins and unit directions (R, 3)."""
        return self._origins[index], self._directions[index]

    def targets(self, index: Tensor) -> tuple[Tensor, Tensor]:
        """Straight display codes (R, 3) and coverage (R,), in [0, 1]."""
        return self._codes[index], self._coverage[index]

    def draw(self, count: int, generator: torch.Generator) -> Tensor:
        """Indices (count,): half of the pixels lie in masks, half anywhere."""
        half = count // 2
        chosen = torch.randint(len(self.inside), (half,), generator=generator)
        rest = torch.randint(self.count, (count - half,), generator=generator)
        return torch.cat([self.inside[chosen], rest])


@dataclass(frozen=True, slots=True, kw_only=True)
class Neus:
    """A fitted field."""

    sdf: SdfNetwork  # signed distance and feature
    colour: RadianceNetwork  # display codes from position, ray, normal and feature
    log_steepness: nn.Parameter  # tenth of the logarithm of the opacity's steepness, ()

    @classmethod
    def start(cls, config: NeusConfig) -> Neus:
        """A sphere of unknown colour."""
        return cls(
            sdf=SdfNetwork(config.depth, config.width, config.octaves),
            colour=RadianceNetwork(config.colour_depth, config.colour_width, config.width),
            log_steepness=nn.Parameter(torch.tensor(0.3)),
        )

    def modules(self) -> dict[str, nn.Module]:
        """Networks by name."""
        return {"sdf": self.sdf, "colour": self.colour}

    def steepness(self) -> Tensor:
        """Steepness of the logistic opacity, 1 / unit, ()."""
        return torch.exp(10.0 * self.log_steepness)

    def radiance(self, points: Tensor, rays: Tensor) -> Tensor:
        """Display codes (P, 3) that leave surface points against rays (P, 3); no gradients."""
        _, feature, gradient = self.sdf.with_gradient(points)
        return self.colour(points, rays, gradient, feature).detach()


def fit_neus(pixels: PhotoRays, config: NeusConfig, generator: torch.Generator) -> Neus:
    """Fit a field to the photographs.

    Args:
        pixels: Of the training views.
        config: The schedule.
        generator: Source of rays and samples; the networks start from torch's own.

    Raises:
        QualityError: If the loss stops being a number.
    """
    field = Neus.start(config)
    weights = [*field.sdf.parameters(), *field.colour.parameters()]
    adam = torch.optim.Adam(
        [
            {"params": weights, "base": config.learning_rate},
            {"params": [field.log_steepness], "base": config.steepness_rate},
        ]
    )
    for step in range(config.iterations):
        share = step / config.iterations
        factor = min((step + 1) / max(config.warm_up, 1), 1.0) * 0.01**share
        for group in adam.param_groups:
            group["lr"] = group["base"] * factor
        chosen = pixels.draw(config.rays, generator)
        loss = _loss(field, pixels, chosen, config, generator)
        if not math.isfinite(loss.item()):
            raise QualityError("The NeuS fit diverged: its loss is no longer a number.")
        adam.zero_grad(set_to_none=True)
        loss.backward()
        adam.step()
    return field


def _loss(
    field: Neus, pixels: PhotoRays, chosen: Tensor, config: NeusConfig, generator: torch.Generator
) -> Tensor:
    origins, directions = pixels.rays(chosen)
    codes, coverage = pixels.targets(chosen)
    samples = sample_rays(field.sdf, (origins, directions), config, generator)
    rendered, opaque, gradient = _render(field, (origins, directions), samples)
    masked = coverage[:, None] * (rendered - codes)
    colour = (masked**2).sum() / (3.0 * coverage.sum()).clamp_min(1.0)
    free = torch.rand(_FREE_POINTS, 3, generator=generator) * 2.0 - 1.0
    slopes = torch.cat([gradient, field.sdf.with_gradient(free)[2]]).norm(dim=-1)
    eikonal = ((slopes - 1.0) ** 2).mean()
    mask = ((opaque - coverage) ** 2).mean()
    return colour + EIKONAL_WEIGHT * eikonal + MASK_WEIGHT * mask


def _render(
    field: Neus, rays: tuple[Tensor, Tensor], samples: tuple[Tensor, Tensor]
) -> tuple[Tensor, Tensor, Tensor]:
    """Codes (R, 3) before white, coverage (R,), and gradients where anything is seen (P, 3)."""
    origins, directions = rays
    distance, sdf = samples
    points = origins[:, None] + distance[..., None] * directions[:, None]
    with torch.no_grad():
        seen = _weights(sdf, field.steepness()) > _LEAST_WEIGHT
    marked = torch.zeros_like(sdf, dtype=torch.bool)
    marked[:, :-1] |= seen
    marked[:, 1:] |= seen
    values, feature, gradient = field.sdf.with_gradient(points[marked])
    sdf = sdf.masked_scatter(marked, values)
    weight = _weights(sdf, field.steepness())
    # An interval has the mean colour of its ends.
    share = 0.5 * (nn.functional.pad(weight, (0, 1)) + nn.functional.pad(weight, (1, 0)))
    towards = directions[:, None].expand_as(points)[marked]
    codes = field.colour(points[marked], towards, gradient, feature)
    owner = torch.nonzero(marked)[:, 0]
    rendered = codes.new_zeros(len(origins), 3)
    rendered = rendered.index_add(0, owner, share[marked][:, None] * codes)
    opaque = weight.sum(dim=1)
    return rendered + (1.0 - opaque)[:, None], opaque, gradient


def _weights(sdf: Tensor, steepness: Tensor | float) -> Tensor:
    """Share of the pixel of every interval, (R, S - 1)."""
    scaled = sdf * steepness
    log_step = volume.log_survival(scaled[:, :-1].flatten(), scaled[:, 1:].flatten(), 1.0)
    num_rays, num_intervals = sdf.shape[0], sdf.shape[1] - 1
    first = torch.arange(num_rays).repeat_interleave(num_intervals) * num_intervals
    return volume.weights(log_step, first).view(num_rays, num_intervals)


@torch.no_grad()
def sample_rays(
    sdf: SdfNetwork, rays: tuple[Tensor, Tensor], config: NeusConfig, generator: torch.Generator
) -> tuple[Tensor, Tensor]:
    """Samples of rays (R, S), ascending: even ones, then more where the surface may be.

    Every round takes the weights of a steeper opacity, 64 2^i, as a density (NeuS Sec. 3.3).

    Returns:
        Their distances along the rays and their signed distances.
    """
    origins, directions = rays
    middle = -(origins * directions).sum(dim=1, keepdim=True)
    beside = (origins**2).sum(dim=1, keepdim=True) - middle**2
    half = (SPHERE**2 - beside).clamp_min(1e-4).sqrt()
    jitter = torch.rand(len(origins), 1, generator=generator)
    even = (torch.arange(config.coarse_samples) + jitter) / config.coarse_samples
    distance = middle + half * (2.0 * even - 1.0)
    value = _along(sdf, rays, distance)
    count = config.fine_samples // config.rounds
    for number in range(config.rounds):
        weight = _weights(value, _SEARCH_STEEPNESS * 2.0**number) + 1e-5
        fresh = _inverse_samples(distance, weight, count)
        joined = torch.cat([value, _along(sdf, rays, fresh)], dim=1)
        distance, order = torch.cat([distance, fresh], dim=1).sort(dim=1)
        value = joined.gather(1, order)
    return distance, value


def _along(sdf: SdfNetwork, rays: tuple[Tensor, Tensor], distance: Tensor) -> Tensor:
    origins, directions = rays
    return sdf(origins[:, None] + distance[..., None] * directions[:, None])[..., 0]


def _inverse_samples(distance: Tensor, weight: Tensor, count: int) -> Tensor:
    """Distances (R, count) at even quantiles of a density constant on intervals."""
    total = torch.cumsum(weight, dim=1)
    total = nn.functional.pad(total / total[:, -1:], (1, 0))
    wanted = ((torch.arange(count) + 0.5) / count).expand(len(distance), -1).contiguous()
    above = torch.searchsorted(total, wanted, right=True).clamp(1, distance.shape[1] - 1)
    low, high = total.gather(1, above - 1), total.gather(1, above)
    begin, end = distance.gather(1, above - 1), distance.gather(1, above)
    return begin + (end - begin) * (wanted - low) / (high - low).clamp_min(1e-9)
