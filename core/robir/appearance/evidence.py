# SPDX-License-Identifier: Apache-2.0
"""How bright the light as a whole is, by two priors or by a spot of known albedo.

Photographs of diffuse surfaces know light and albedo by their product alone. The log likelihoods of
common albedos and of common exposures are added: white is about as bright as the brightest that a
photograph shows, as by an incident-light meter.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from robir.appearance.light.known_albedo import KnownAlbedo
from robir.appearance.light.lobes import BRIGHTEST_QUANTILE, log_ratio, log_sent
from robir.appearance.light.problem import Problem
from robir.appearance.light.solver import Light
from robir.appearance.material.specular import SpecularMaterial

# names of the last rows: all evidence together, and the albedo that the user knows, if any
BY_ALL, BY_KNOWN_ALBEDO = "all", "known paint"


@dataclass(frozen=True, slots=True, kw_only=True)
class Estimate:
    """One row of the report's table of evidence."""

    # "level", mean over the channels of the log mean irradiance; or "hue", log of its red over its
    # blue
    of: str
    by: str  # the evidence
    value: float  # log units
    deviation: float  # one standard deviation

    def plain(self) -> dict[str, Any]:
        """As JSON has it."""
        return asdict(self)


Reals = NDArray[np.float64]

_DARKEST = -2.0  # log of the least factor that is tried on the light
_BRIGHTEST = 3.0  # log of the greatest
_NUM_FACTORS = 21  # factors that are tried, these two among them
# mean log albedo of what photographs show, on average: of 26 drawn captures of both halves, seeds 0
# to 12 and 100 to 112 (without metal -2.2, all -2.0)
_LOG_ALBEDO = -2.1
_LOG_ALBEDO_SPREAD = 0.75  # its deviation (log units)
# log radiance of white paint in the mean light, 1 being what the plain curve shows as white, on
# average: of the same captures
_EXPOSURE = -0.25
_EXPOSURE_SPREAD = 0.57  # its deviation (log units)
_EXCESS = 0.1  # how far the brightest paint may seem to return more than it receives (log units)
_NUM_SAMPLES = 4  # of the surface, nearest to the spot, that show its paint


def log_factors() -> Reals:
    """Logs of the factors that are tried on the light, (F,)."""
    return np.linspace(_DARKEST, _BRIGHTEST, _NUM_FACTORS)


def level_estimates(
    problem: Problem, light: Light, specular: SpecularMaterial, solved: NDArray[np.int64]
) -> tuple[Estimate, ...]:
    """What each prior says of the mean over channels of the log mean irradiance of sky and suns.

    Of a light right but for its brightness, the specular material under it, and the samples (U,)
    that it is solved by. Both priors together come last; nothing where all is metal.
    """
    chosen = problem.radiance.seen.numpy() & specular.is_dielectric
    rows = problem.scene.rows[chosen[problem.scene.rows]]
    if not len(rows):
        return ()
    albedo = log_ratio(problem.radiance.linear[rows], light.irradiance(problem, rows)).numpy()
    sent = float(log_sent(light.irradiance(problem, solved), problem.indirect[solved]).mean())
    priors = {"common paints": albedo_prior(albedo), "exposure": exposure_prior(sent)}
    priors[BY_ALL] = priors["common paints"] + priors["exposure"]
    return tuple(_estimate(by, log_likelihood, sent) for by, log_likelihood in priors.items())


def _estimate(by: str, log_likelihood: Reals, sent: float) -> Estimate:
    """Mean and deviation of the level under log likelihoods (F,), up to a constant."""
    factors = log_factors()
    posterior = np.exp(log_likelihood - log_likelihood.max())
    posterior /= posterior.sum()
    mean = float(posterior @ factors)
    deviation = float(np.sqrt(posterior @ (factors - mean) ** 2))
    return Estimate(of="level", by=by, value=sent + mean, deviation=deviation)


def albedo_prior(albedo: NDArray[np.floating]) -> Reals:
    """Log likelihood (F,) of log albedos (U, 3), were the light brighter by each factor."""
    factors = log_factors()
    mean = (albedo.mean() - factors - _LOG_ALBEDO) / _LOG_ALBEDO_SPREAD
    brightest = np.quantile(albedo.max(1), BRIGHTEST_QUANTILE) - factors
    return -0.5 * (mean**2 + (brightest.clip(0) / _EXCESS) ** 2)


def exposure_prior(sent: float) -> Reals:
    """Log likelihood (F,) of a mean log irradiance, were the light brighter by each factor."""
    white = sent - np.log(np.pi) + log_factors()
    return -0.5 * ((white - _EXPOSURE) / _EXPOSURE_SPREAD) ** 2


def sent_by_known_albedo(problem: Problem, light: Light, known: KnownAlbedo) -> Tensor:
    """Log (3,) of the mean irradiance that sky and suns send if the spot has its albedo.

    Of a light whose level and hue as a whole are not known.
    """
    surfels, rows = problem.scene.transport.surfels, problem.scene.rows
    seen = np.flatnonzero(problem.radiance.seen.numpy())
    own = surfels.subset(problem.radiance.seen.numpy())
    near = seen[own.nearest(known.position[None], known.normal[None], _NUM_SAMPLES)[0]]
    albedo = log_ratio(problem.radiance.linear[near], light.irradiance(problem, near)).exp()
    sent = log_sent(light.irradiance(problem, rows), problem.indirect[rows])
    return sent + torch.from_numpy(known.off(albedo.numpy()))
