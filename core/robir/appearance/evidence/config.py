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
class LobeChangesConfig:
    """How lobes of the sky are changed until they show what views show.

    Attributes:
        freedom: Usual change of the logarithm of a lobe.
        alike_views: Views that count as one: errors of normals are common to many.
        kept_samples: Samples that keep their irradiance, however many there are: what was solved
            without what is mirrored is not exact either.
        most_step: Most that a logarithm changes in one round.
        num_rounds: Rounds at most.
        settled: Change of every logarithm below which a round is the last.
    """

    freedom: Annotated[float, Within(0.01, 100, "log units")] = 1.0
    alike_views: Annotated[float, Within(0.1, 1000)] = 3.0
    kept_samples: Annotated[float, Within(0, 100000)] = 30.0
    most_step: Annotated[float, Within(0.01, 10, "log units")] = 0.7
    num_rounds: Annotated[int, Within(1, 200)] = 12
    settled: Annotated[float, Within(0, 0.1, "log units")] = 1e-3


@dataclass(frozen=True, slots=True, kw_only=True)
class ReflectedSkyConfig:
    """The sky as paint reflects it.

    Attributes:
        roughnesses: That are tried where no sun tells it. The lobes cannot tell sharper ones; of
            rougher ones views differ by less than is known of what they reflect.
        half_believed: Difference between views of a sample at which one counts half: beyond lie
            errors of the mesh.
        kept_errors: Shares by which the irradiance of samples may change: where shadows on a ground
            tell the light it is well known, by the shading of a lone thing it is not.
        num_folds: Parts of the surface of which each is predicted by the lobes that the others
            tell.
        num_samples: Of the samples that take part in the light solve, looked at.
        num_fitted: Of their observations, fitted to: there are 200 unknowns.
    """

    roughnesses: Annotated[tuple[float, float, float, float], Within(0.05, 1)] = (
        0.2,
        0.3,
        0.42,
        0.56,
    )
    half_believed: Annotated[float, Within(0.1, 1000, "codes")] = 20.0
    kept_errors: Annotated[tuple[float, float, float], Within(1e-4, 10)] = (0.05, 0.2, 0.8)
    num_folds: Annotated[int, Within(2, 20)] = 3
    num_samples: Annotated[int, Within(100, 100000)] = 2500
    num_fitted: Annotated[int, Within(500, 1000000)] = 12000


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
        lobe_changes: How lobes of the sky are changed.
        reflected_sky: The sky as paint reflects it.
        white_point: What known paint tells.
    """

    level: LevelConfig = field(default_factory=LevelConfig)
    lobe_changes: LobeChangesConfig = field(default_factory=LobeChangesConfig)
    reflected_sky: ReflectedSkyConfig = field(default_factory=ReflectedSkyConfig)
    white_point: WhitePointConfig = field(default_factory=WhitePointConfig)
