# SPDX-License-Identifier: Apache-2.0
"""The light of one scene under one tone curve: strengths of suns and sky."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from robir.appearance.config import AppearanceConfig
from robir.appearance.light.lobes import (
    Amplitudes,
    LightPrior,
    Priors,
    Transfer,
    log_ratio,
    log_sent,
    solve_amplitudes,
)
from robir.appearance.light.problem import Problem
from robir.appearance.light.sunlight import Sunlight, of_one_material, well_lit
from robir.appearance.photometry.statistics import Pairs

Floats = NDArray[np.float32]

# difference in hue at which neighbours hardly are one material, once a light is known. Sky and sun
# differ in hue as well, and the sky is not known well. From 0.1 to 0.4 all gives about the same
# (log albedo)
_NEIGHBOUR_HUE = 0.2
# weight of equal albedo across shadows once a light tells which pairs are one material
_SHADOW = 1.0
# weight of an even sky where few albedos are asked for: a bright patch of sky would turn one
# material into another
_SMOOTH = 0.05
# weight of equal albedo where the hue is one, anywhere on the surface. Suns and curve are found
# without: under a wrong curve it would make albedos alike as well.
_FAR = 2.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Light:
    """A solved light."""

    axes: Floats  # (J, 3) float32 axes of the sharp lobes, towards the light
    sharpness: Floats  # (J,) float32
    amplitudes: Amplitudes  # strengths of soft and sharp lobes
    loss: float  # mean absolute difference of log albedo between neighbours
    # the same of neighbours that face alike with 0, 1, ... sharp lobes, for the report
    history: tuple[float, ...]

    def irradiance(self, problem: Problem, rows: NDArray[np.int64]) -> Tensor:
        """What some samples receive, (len(rows), 3), from suns, sky and other surfaces."""
        sharp = problem.scene.sharp_transfer(self.axes, self.sharpness, rows)
        return self.amplitudes.irradiance(problem.transfer(sharp, rows))

    def tinted(self, log_factor: Tensor) -> Light:
        """Every lobe exp(log_factor) (3,) as bright."""
        strengths, factor = self.amplitudes, log_factor.exp()
        tinted = Amplitudes(soft=strengths.soft * factor, sharp=strengths.sharp * factor)
        return replace(self, amplitudes=tinted)


def no_suns() -> tuple[Floats, Floats]:
    """Axes and sharpness of no sharp lobes."""
    return np.zeros((0, 3), np.float32), np.zeros(0, np.float32)


def fit(
    problem: Problem,
    axes: Floats,
    sharpness: Floats,
    iterations: int,
    start: Amplitudes | None = None,
) -> Light:
    """Strengths of all lobes for fixed suns, of axes (J, 3) and sharpness (J,)."""
    transfer, sunlight = _lit_by(problem, axes, sharpness)
    amplitudes, loss = solve_amplitudes(
        problem.rows_radiance(problem.scene.rows),
        transfer,
        (problem.scene.pairs, Pairs.joined(sunlight.across_shadows())),
        Priors(),
        iterations,
        start=start,
    )
    return Light(axes=axes, sharpness=sharpness, amplitudes=amplitudes, loss=loss, history=())


def _lit_by(problem: Problem, axes: Floats, sharpness: Floats) -> tuple[Transfer, Sunlight]:
    """Transfer of the samples that take part, and how they stand to the suns."""
    sharp = problem.scene.sharp_transfer(axes, sharpness, problem.scene.rows)
    sunlight = Sunlight.of(problem, axes)
    transfer = problem.transfer(sharp, problem.scene.rows)
    return replace(transfer, certain=sunlight.is_certain()), sunlight


def refit(problem: Problem, light: Light, prior: LightPrior, config: AppearanceConfig) -> Light:
    """Strengths once more, shadows deciding between sky and suns; without highlights if known.

    The neighbour loss prefers a weak sun, as errors of normals change a sun's light and hardly a
    sky's. Across a shadow, at equal normals, they cancel. Pairs that are alike but for their common
    step count most there, or a weak sun would confirm itself on a checkered ground. Neighbours of
    another hue say nothing of each other's brightness.
    """
    radiance = problem.rows_radiance(problem.scene.rows)
    transfer, sunlight = _lit_by(problem, light.axes, light.sharpness)
    sent = log_sent(light.amplitudes.irradiance(transfer), transfer.indirect)
    light = light.tinted(prior.missing(sent))
    irradiance = light.amplitudes.irradiance(transfer)
    log_albedo = log_ratio(radiance.linear, irradiance)
    across = well_lit(sunlight.across_shadows(), irradiance)
    neighbours = problem.scene.pairs
    likeness = neighbours.likeness(log_albedo, _NEIGHBOUR_HUE, np.inf)
    alike = of_one_material(across, log_albedo, radiance.clipped)
    parts = (neighbours.weighted(likeness), alike)
    priors = Priors(
        smooth=_SMOOTH,
        shadow=_SHADOW,
        light=prior,
        far=_FAR,
    )
    amplitudes, loss = solve_amplitudes(
        radiance, transfer, parts, priors, config.iterations // 2, start=light.amplitudes
    )
    solved = replace(light, amplitudes=amplitudes, loss=loss)
    # pairs tell ratios; the level by which they are most alike is that of the mesh's errors
    sent = log_sent(amplitudes.irradiance(transfer), transfer.indirect)
    return solved.tinted(prior.missing(sent))
