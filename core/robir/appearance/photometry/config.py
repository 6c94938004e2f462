# SPDX-License-Identifier: Apache-2.0
"""Settings of what photographs tell about how they were exposed and lit."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated

from robir.settings import Within


@dataclass(frozen=True, slots=True, kw_only=True)
class ComparisonConfig:
    """Which points photographs are compared by.

    Attributes:
        num_points: Surface points that are compared.
        image_side: Longest side that photographs are read at.
    """

    num_points: Annotated[int, Within(100, 20000)] = 1500
    image_side: Annotated[int, Within(32, 2000, "pixels")] = 200


@dataclass(frozen=True, slots=True, kw_only=True)
class ExposureConfig:
    """Which views of a point are compared.

    Attributes:
        least_cosine: Cosine from which a view of a point counts: flatter ones show mostly sheen.
        darkest: Code from which a curve's slope is worth something in all three channels.
        brightest: Code up to which it is.
        least_views: Views of a point from which photographs can be compared.
    """

    least_cosine: Annotated[float, Within(0.05, 0.9)] = 0.5
    darkest: Annotated[int, Within(0, 100, "codes")] = 10
    brightest: Annotated[int, Within(150, 255, "codes")] = 250
    least_views: Annotated[int, Within(2, 50)] = 4


@dataclass(frozen=True, slots=True, kw_only=True)
class GainsConfig:
    """How far photographs count as exposed apart.

    Attributes:
        orientation_cells: Cells per unit of a normal's components, points of one erring together:
            some forty degrees.
        least_points: Points in all from which photographs can be compared.
    """

    orientation_cells: Annotated[float, Within(0.5, 10)] = 1.5
    least_points: Annotated[int, Within(8, 10000)] = 50


@dataclass(frozen=True, slots=True, kw_only=True)
class OtherLightConfig:
    """When a photograph counts as taken under another light than the rest.

    Attributes:
        least_steps: How much brighter or darker than the rest it must be: more than gloss makes it.
        least_spread: How much of that its points must differ among each other: more than in one
            exposed otherwise.
        most_common_spread: Median difference beyond which the rest do not agree themselves: metal,
            of which all photographs differ, comes to .35, and so does a light that moves with the
            camera.
        most_views: Share of photographs beyond which there is no common light to differ from.
        least_points: Points that a photograph must show to be judged.
    """

    least_steps: Annotated[float, Within(0, 5, "steps")] = 0.5
    least_spread: Annotated[float, Within(0, 2)] = 0.3
    most_common_spread: Annotated[float, Within(0.01, 5, "log radiance")] = 0.25
    most_views: Annotated[float, Within(0, 0.5)] = 0.25
    least_points: Annotated[int, Within(1, 10000)] = 20


@dataclass(frozen=True, slots=True, kw_only=True)
class OwnLightConfig:
    """When photographs count as taken each in a light of its own.

    Attributes:
        place_size: Side of the cubes within which points err together.
        sheen_degree: Of the rival sheen's polynomials: of the second, a ball with a Phong exponent
            of 8 passes for one in lights of its own.
        sheen_rounds: Turns of points and sheen.
        sheen_ridge: Weight of the sheen's prior against the trace of its equations.
    """

    place_size: Annotated[float, Within(0.01, 2, "unit frame")] = 0.15
    sheen_degree: Annotated[int, Within(1, 6)] = 3
    sheen_rounds: Annotated[int, Within(1, 100)] = 8
    sheen_ridge: Annotated[float, Within(1e-9, 1)] = 1e-4


@dataclass(frozen=True, slots=True, kw_only=True)
class RobustConfig:
    """How much each observation counts.

    Attributes:
        prior_steps: Standard deviation of gains before anything is seen.
        normal_sharpness: Of the lobe within which normals share one vote: 10 are about 25 degrees.
        noise: Deviation between views of which a photograph's noise alone is capable.
        first_width: Deviation from which an observation counts little (Geman-McClure), at first.
        last_width: The same in the end.
        narrowing: By what that shrinks from round to round.
        num_rounds: Solves, weights renewed after each.
    """

    prior_steps: Annotated[float, Within(0.01, 10, "steps")] = 0.5
    normal_sharpness: Annotated[float, Within(0, 1000)] = 10.0
    noise: Annotated[float, Within(1e-4, 1, "log radiance")] = 0.02
    first_width: Annotated[float, Within(0.01, 5, "log radiance")] = 0.4
    last_width: Annotated[float, Within(0.001, 5, "log radiance")] = 0.05
    narrowing: Annotated[float, Within(0.1, 1)] = 0.7
    num_rounds: Annotated[int, Within(1, 200)] = 20


@dataclass(frozen=True, slots=True, kw_only=True)
class StatisticsConfig:
    """One radiance a sample, and pairs across shadows.

    Attributes:
        low_share: Rank of brightness from which a sample's views are averaged: pixels darkened by
            an outline lie below.
        high_share: Rank up to which they are: highlights lie above.
        clipped_share: Weight of its clipped views from which a sample is clipped.
        shadow_reach: How far apart a sample in shadow and its lit partner may lie. Under a low sun
            shadows are longer than what casts them.
        shadow_normal: What a difference of one unit of normal counts in that distance.
        least_shadow_samples: In the shadow and lit, from which a shadow is compared.
        shadow_partners: Lit partners of a sample in shadow.
        shadow_parts: Of how many lit samples one may be its partner, at least. The nearest all hug
            the shadow's edge, where photographs blur it and the mesh displaces it; of those far
            away more are of another paint.
        largest_part: Of how many samples, lit or not, a part of these consists at most.
        step_width: Width of the kernel that finds the commonest step across shadows: more than
            noise, less than the difference between the materials of a scene.
        step_pairs: Pairs that tell a step.
        step_starts: Those of them from which it is searched.
        step_rounds: Rounds of the search.
    """

    low_share: Annotated[float, Within(0, 0.5)] = 0.1
    high_share: Annotated[float, Within(0.1, 1)] = 0.5
    clipped_share: Annotated[float, Within(0, 1)] = 0.3
    shadow_reach: Annotated[float, Within(0.01, 4, "unit frame")] = 0.8
    shadow_normal: Annotated[float, Within(0, 10, "unit frame")] = 0.6
    least_shadow_samples: Annotated[int, Within(1, 10000)] = 20
    shadow_partners: Annotated[int, Within(1, 200)] = 12
    shadow_parts: Annotated[int, Within(1, 100)] = 4
    largest_part: Annotated[int, Within(10, 1000000)] = 1250
    step_width: Annotated[float, Within(0.01, 2, "log units")] = 0.15
    step_pairs: Annotated[int, Within(10, 100000)] = 4000
    step_starts: Annotated[int, Within(1, 10000)] = 400
    step_rounds: Annotated[int, Within(0, 1000)] = 30


@dataclass(frozen=True, slots=True, kw_only=True)
class VignettingConfig:
    """How a lens may darken corners.

    Attributes:
        prior: Standard deviation of the falloff's strength before anything is seen.
    """

    prior: Annotated[float, Within(0.01, 100, "log radiance")] = 1.0


@dataclass(frozen=True, slots=True, kw_only=True)
class PhotometryConfig:
    """How photographs of the same points are compared.

    Attributes:
        comparison: Which points that is done by.
        exposure: Which views of them.
        gains: When photographs count as exposed apart.
        other_light: When one counts as taken under another light.
        own_light: When each counts as taken in a light of its own.
        robust: How much each observation counts.
        statistics: One radiance a sample, and pairs across shadows.
        vignetting: Corners of photographs.
    """

    comparison: ComparisonConfig = field(default_factory=ComparisonConfig)
    exposure: ExposureConfig = field(default_factory=ExposureConfig)
    gains: GainsConfig = field(default_factory=GainsConfig)
    other_light: OtherLightConfig = field(default_factory=OtherLightConfig)
    own_light: OwnLightConfig = field(default_factory=OwnLightConfig)
    robust: RobustConfig = field(default_factory=RobustConfig)
    statistics: StatisticsConfig = field(default_factory=StatisticsConfig)
    vignetting: VignettingConfig = field(default_factory=VignettingConfig)
