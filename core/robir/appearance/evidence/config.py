# SPDX-License-Identifier: Apache-2.0
"""Settings of what highlights, known paint and reflections tell of the light."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated

from robir.settings import Within


@dataclass(frozen=True, slots=True, kw_only=True)
class LevelConfig:
    """What tells how bright the light as a whole is.

    Attributes:
        darkest: Log of the least factor that is tried on the light.
        brightest: Log of the greatest.
        num_factors: Factors that are tried, these two among them.
        paint: Mean log albedo of what photographs show, on average: of the development population,
            whose mean is .16; photography's mean scene reflects .18 (Jones and Condit 1941, "The
            brightness scale of exterior scenes").
        paint_spread: Its deviation.
        exposure: Log radiance of white paint in the mean light, 1 being what the plain curve shows
            as white, on average: of the development population.
        exposure_spread: Its deviation.
        excess: How far the brightest paint may seem to return more than it receives.
        misread: Deviation of the log factor that is left of one told by many views alike: where the
            mesh is more wrong than is tried, highlights are missed and the light is told too dim.
        num_patches: Patches of paint, each of its own roughness.
        num_samples: Of the samples that take part in the light solve, looked at.
        firmness: How much more firmly a told level is held than its error asks. In a solve pairs of
            neighbours speak of it as well, by the light between surfaces, and errors of the mesh
            are common to many.
    """

    darkest: Annotated[float, Within(-10, -0.1, "log units")] = -2.0
    brightest: Annotated[float, Within(0.1, 10, "log units")] = 3.0
    num_factors: Annotated[int, Within(3, 200)] = 21
    paint: Annotated[float, Within(-5, 0, "log albedo")] = -1.85
    paint_spread: Annotated[float, Within(0.05, 10, "log units")] = 0.65
    exposure: Annotated[float, Within(-5, 5, "log radiance")] = -0.15
    exposure_spread: Annotated[float, Within(0.05, 10, "log units")] = 0.65
    excess: Annotated[float, Within(0.01, 10, "log units")] = 0.1
    misread: Annotated[float, Within(0.01, 10, "log units")] = 0.42
    num_patches: Annotated[int, Within(1, 200)] = 16
    num_samples: Annotated[int, Within(20, 100000)] = 450
    firmness: Annotated[float, Within(0.1, 100)] = 3.0


@dataclass(frozen=True, slots=True, kw_only=True)
class WhitePointConfig:
    """What a spot of known paint tells of the light.

    Attributes:
        num_samples: Of the surface, nearest to the spot, that show its paint.
    """

    num_samples: Annotated[int, Within(2, 100)] = 4


@dataclass(frozen=True, slots=True, kw_only=True)
class EvidenceConfig:
    """What highlights, known paint and reflections tell of the light.

    Attributes:
        level: What tells how bright it is.
        white_point: What known paint tells.
    """

    level: LevelConfig = field(default_factory=LevelConfig)
    white_point: WhitePointConfig = field(default_factory=WhitePointConfig)
