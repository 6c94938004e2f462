# SPDX-License-Identifier: Apache-2.0
"""The light by a spot of known albedo, which settles both level and hue."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from robir.appearance.light.known_albedo import KnownAlbedo
from robir.appearance.light.lobes import log_ratio, log_sent
from robir.appearance.light.problem import Problem
from robir.appearance.light.solver import Light

_NUM_SAMPLES = 4  # of the surface, nearest to the spot, that show its paint


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
