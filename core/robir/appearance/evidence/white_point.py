# SPDX-License-Identifier: Apache-2.0
"""What a spot tells of the light whose paint the user knows.

Photographs of diffuse surfaces know light and albedo by their product alone. One albedo that is
known settles both, level and hue, better than highlights or what paints commonly are. It is told to
the solve of the light, since the specular layer is judged by how bright that is, and held to at the
end.
"""

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

    Args:
        problem: Scene under a tone curve, without highlights if they are known.
        light: Its light, of which all but level and hue as a whole is taken for right.
        known: The spot.
    """
    surfels, rows = problem.scene.transport.surfels, problem.scene.rows
    seen = np.flatnonzero(problem.radiance.seen.numpy())
    own = surfels.subset(problem.radiance.seen.numpy())
    near = seen[own.nearest(known.position[None], known.normal[None], _NUM_SAMPLES)[0]]
    albedo = log_ratio(problem.radiance.linear[near], light.irradiance(problem, near)).exp()
    sent = log_sent(light.irradiance(problem, rows), problem.indirect[rows])
    return sent + torch.from_numpy(known.off(albedo.numpy()))
