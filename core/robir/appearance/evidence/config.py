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
        paint: Mean log albedo of what photographs show, on average: of 26 drawn captures of both
            halves, seeds 0 to 12 and 100 to 112 (without metal -2.2, all -2.0).
        paint_spread: Its deviation.
        exposure: Log radiance of white paint in the mean light, 1 being what the plain curve shows
            as white, on average: of the same captures.
        exposure_spread: Its deviation.
        excess: How far the brightest paint may seem to return more than it receives.
        firmness: How much more firmly a told level is held than its error asks. In a solve pairs of
            neighbours speak of it as well, by the light between surfaces, and errors of the mesh
            are common to many.
    """

    darkest: Annotated[float, Within(-10, -0.1, "log units")] = -2.0
    brightest: Annotated[float, Within(0.1, 10, "log units")] = 3.0
    num_factors: Annotated[int, Within(3, 200)] = 21
    paint: Annotated[float, Within(-5, 0, "log albedo")] = -2.1
    paint_spread: Annotated[float, Within(0.05, 10, "log units")] = 0.75
    exposure: Annotated[float, Within(-5, 5, "log radiance")] = -0.25
    exposure_spread: Annotated[float, Within(0.05, 10, "log units")] = 0.57
    excess: Annotated[float, Within(0.01, 10, "log units")] = 0.1
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
