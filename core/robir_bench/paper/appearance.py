# SPDX-License-Identifier: Apache-2.0
"""PBR and CESR: light, tone curve and material, first under learnt visibility, then under ratios.

Batch letters: P points, K lobes of the environment, D directions.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from robir.maths.spherical_gaussian import SphericalGaussians
from robir.maths.vectors import dot, fibonacci_sphere
from robir_bench.paper.config import LossWeights, PaperConfig
from robir_bench.paper.light import EnvironmentLight, Surface
from robir_bench.paper.losses import edge_loss, smoothness_loss, sparsity_loss, whiteness_loss
from robir_bench.paper.networks import (
    IndirectNetwork,
    MaterialNetwork,
    RatioNetwork,
    VisibilityNetwork,
)
from robir_bench.paper.shading import (
    diffuse_transfer,
    exitant_radiance,
    specular_transfer,
    visibility_ratio,
)
from robir_bench.paper.tone import AbstractTone
from robir_bench.paper.transport import SeenPoints, TransportNetworks

_CHUNK = 256


@dataclass(frozen=True, slots=True, kw_only=True)
class Sky:
    """Directions at which visibility is known, in place of samples about every lobe."""

    directions: Tensor  # (D, 3), evenly spread

    @classmethod
    def spread(cls, count: int) -> Sky:
        """So many directions."""
        return cls(directions=fibonacci_sphere(count))

    @torch.no_grad()
    def visibility(self, network: VisibilityNetwork, hits: SeenPoints) -> Tensor:
        """Visibility (P, D), float16, of points; 0 below their horizon, as RobIR has it.

        Lobes across the horizon are thereby cut twice, here and by the cosine.
        """
        rows = []
        for points, normals in zip(
            hits.points.split(_CHUNK), hits.normals.split(_CHUNK), strict=True
        ):
            above = dot(self.directions, normals[:, None]) > 1e-6
            rows.append((network(points, self.directions) * above).half())
        return torch.cat(rows)


@dataclass(frozen=True, slots=True, kw_only=True)
class Model:
    """All that PBR and CESR learn."""

    material: MaterialNetwork  # albedo and roughness
    light: EnvironmentLight  # environment
    surface: Surface  # f0
    tone: AbstractTone  # tone curve
    # visibility ratios, or None where those of the visibility network hold
    ratio: RatioNetwork | None

    def lights(self) -> list[nn.Parameter]:
        """Parameters of light, F0 and tone curve."""
        modules = (self.light, self.surface, self.tone)
        return [value for module in modules for value in module.parameters()]


@torch.no_grad()
def render_display(model: Model, networks: TransportNetworks, sky: Sky, hits: SeenPoints) -> Tensor:
    """Display codes (P, 3) in [0, 1] of points seen by cameras."""
    codes = []
    for start in range(0, len(hits.points), _CHUNK):
        part = hits.rows(slice(start, start + _CHUNK))
        if model.ratio is None:
            visible = sky.visibility(networks.visibility, part).float()
            ratio = visibility_ratio(model.light.lobes(), sky.directions, visible)
        else:
            ratio = model.ratio(part.points)
        radiance = render(model, networks.indirect, part, model.material(part.points), ratio)
        codes.append(model.tone.curve().display_from_linear(radiance))
    return torch.cat(codes) if codes else torch.zeros(0, 3)


def render(
    model: Model,
    indirect: IndirectNetwork,
    hits: SeenPoints,
    material: tuple[Tensor, Tensor],
    ratio: Tensor,
) -> Tensor:
    """Radiance (P, 3), linear, that leaves points towards their cameras; RobIR Eq. 11.

    Args:
        model: Light and curve.
        indirect: Frozen.
        hits: Points.
        material: Albedo (P, 3) and roughness (P,).
        ratio: Visibility ratios (P, K), of diffuse and specular light alike.
    """
    albedo, roughness = material
    f0 = model.surface.f0()
    everywhere = torch.ones(())
    total = torch.zeros_like(albedo)
    for lobes, seen in (
        (model.light.lobes(), ratio),
        (indirect(hits.points, model.tone.gamma), everywhere),
    ):
        transfers = _transfers(lobes, seen, hits, roughness, f0)
        total = total + exitant_radiance(transfers, lobes.amplitude, albedo)
    return total


def _transfers(
    lobes: SphericalGaussians, ratio: Tensor, hits: SeenPoints, roughness: Tensor, f0: Tensor
) -> tuple[Tensor, Tensor]:
    frame = (hits.normals, hits.to_camera)
    diffuse = diffuse_transfer(lobes.axis, lobes.sharpness, hits.normals)
    specular = specular_transfer(lobes.axis, lobes.sharpness, frame, roughness, f0)
    return ratio * diffuse, ratio * specular


class Fitter:
    """PBR, then CESR, over one pool of pixels whose points and visibility are known."""

    def __init__(
        self,
        networks: TransportNetworks,
        pool: SeenPoints,
        config: PaperConfig,
        generator: torch.Generator,
    ) -> None:
        """Read the visibility network at every point of the pool."""
        self.sky = Sky.spread(config.ratio_directions)
        self._networks = networks
        for module in networks.modules().values():
            module.requires_grad_(False)
        self._pool = pool
        self._visible = self.sky.visibility(networks.visibility, pool)
        self._config = config
        self._generator = generator

    def fit(self, tone: AbstractTone, has_ratio: bool) -> Model:
        """Both stages.

        Args:
            tone: Curve at its start.
            has_ratio: Whether the second stage learns its own ratios (RVE). Without, it runs all
                the same, and the only difference is where the ratios come from.
        """
        config = self._config
        light = EnvironmentLight(config.light_lobes, self._generator)
        model = Model(
            material=MaterialNetwork(config.material.width, config.code_length),
            light=light,
            surface=Surface(),
            tone=tone,
            ratio=None,
        )
        adam = self._adam(list(model.material.parameters()))
        adam.add_param_group({"params": model.lights(), "lr": config.material.light_rate})
        for _ in range(config.material.iterations):
            hits, visible = self._draw(config.material.pixels)
            ratio = visibility_ratio(light.lobes(), self.sky.directions, visible)
            _take(adam, self._losses(model, hits, ratio, config.material.weights))
        return self._refined(model, has_ratio)

    def _refined(self, before: Model, has_ratio: bool) -> Model:
        """The second stage: light, F0 and curve go on, the material starts anew."""
        config, schedule = self._config, self._config.refinement
        ratios = RatioNetwork(schedule.depth, schedule.width, config.light_lobes)
        model = Model(
            material=MaterialNetwork(config.material.width, config.code_length),
            light=before.light,
            surface=before.surface,
            tone=before.tone,
            ratio=ratios if has_ratio else None,
        )
        if model.ratio is not None:
            adam = self._adam(list(model.ratio.parameters()))
            for _ in range(schedule.warm_up):
                hits, visible = self._draw(schedule.pixels)
                given = visibility_ratio(model.light.lobes(), self.sky.directions, visible)
                _take(adam, edge_loss(model.ratio(hits.points), given.detach()))
        learnt = [] if model.ratio is None else list(model.ratio.parameters())
        adam = self._adam([*model.material.parameters(), *learnt])
        adam.add_param_group({"params": model.lights(), "lr": schedule.light_rate})
        for _ in range(schedule.iterations - schedule.warm_up):
            hits, visible = self._draw(schedule.pixels)
            ratio = given = visibility_ratio(model.light.lobes(), self.sky.directions, visible)
            if model.ratio is not None:
                ratio = model.ratio(hits.points)
            loss = self._losses(model, hits, ratio, schedule.weights)
            if model.ratio is not None:
                loss = loss + schedule.weights.edge * edge_loss(ratio, given)
            _take(adam, loss)
        return model

    def _losses(
        self, model: Model, hits: SeenPoints, ratio: Tensor, weights: LossWeights
    ) -> Tensor:
        code = model.material.code(hits.points)
        indirect = self._networks.indirect
        radiance = render(model, indirect, hits, model.material.decode(code), ratio)
        shown = model.tone.shown(radiance)
        wanted = model.tone.decoded(hits.display)
        image = (shown - wanted).abs().sum(dim=1).mean()
        noise = torch.randn(code.shape, generator=self._generator)
        return (
            image
            + weights.smooth * smoothness_loss(model.material, code, noise)
            + weights.sparse * sparsity_loss(code)
            + weights.white * whiteness_loss(model.light.lobes().amplitude)
        )

    def _adam(self, networks: list[nn.Parameter]) -> torch.optim.Adam:
        return torch.optim.Adam(networks, lr=self._config.learning_rate)

    def _draw(self, count: int) -> tuple[SeenPoints, Tensor]:
        """Random pixels of the pool and their visibility (P, D)."""
        pool = self._pool
        index = torch.randint(len(pool.points), (count,), generator=self._generator)
        return pool.rows(index), self._visible[index].float()


def _take(adam: torch.optim.Adam, loss: Tensor) -> None:
    adam.zero_grad(set_to_none=True)
    loss.backward()
    adam.step()
