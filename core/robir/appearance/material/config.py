# SPDX-License-Identifier: Apache-2.0
"""Settings of gloss and metal."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated

from robir.errors import ConfigError
from robir.settings import Within


@dataclass(frozen=True, slots=True, kw_only=True)
class ReflectionsConfig:
    """What samples reflect towards the cameras.

    Attributes:
        sharpest_highlight: Roughness below which a sun's highlight is narrower than the samples
            can tell.
        sharpest_kernel: Sharpness of the lobe about a mirror direction beyond which the sky's
            directions lie too far from each other.
        highlight_cosine: Between normal and half vector, within which a view is near the mirror
            direction of a sun.
        least_sun: Cosine times visibility of a sun below which it has no highlight.
        tilt: Of the normal that a highlight may need, as a tangent: about the mesh's error.
    """

    sharpest_highlight: Annotated[float, Within(0.01, 1)] = 0.12
    sharpest_kernel: Annotated[float, Within(1, 10000)] = 200.0
    highlight_cosine: Annotated[float, Within(0, 1)] = 0.87
    least_sun: Annotated[float, Within(0, 1)] = 0.1
    tilt: Annotated[float, Within(0, 1)] = 0.12


@dataclass(frozen=True, slots=True, kw_only=True)
class ObservedConfig:
    """How what photographs show is compared with predictions.

    Attributes:
        most_error: Display error, 0..1, beyond which the mesh is wrong, whatever the material, and
            more says no more.
        least_diffuse: Least share of an observation's radiance that is no reflection.
    """

    most_error: Annotated[float, Within(0.001, 1)] = 0.15
    least_diffuse: Annotated[float, Within(1e-4, 1)] = 0.02


@dataclass(frozen=True, slots=True, kw_only=True)
class HighlightsConfig:
    """How roughness is read from highlights, and pooled over like patches.

    Attributes:
        levels: Roughnesses that are tried, rising.
        rough_share: Share of the highlight at the last of these that is left at roughness 1.
        narrow: How many of them have a highlight so narrow that an error of the mesh may put it
            anywhere.
        least_roughness: That paint may have.
        step: Roughnesses are whole multiples of this: finer differences are below the errors of the
            readings, and every one of them has its own pass over its samples.
        fewest_views: Near a sun's mirror direction, that a patch must have to be read.
        half_believed: Views at which what they say counts half: neighbouring samples and views err
            alike.
        steepness: Power of an error ratio that is its likelihood: as if so many views erred each in
            its own way, however many there are.
        peak_error: Deviation of the log of a peak that is seen from the one predicted at the true
            roughness.
        unseen_codes: Errors, codes, below which their ratios mean nothing.
        peak_codes: The same of the heights of peaks.
        top_share: Brightest views of a patch, as a share: all but few are beside a narrow
            highlight.
        steady_share: Samples of a patch, as a share, that speak for it. The others' views err most
            where no highlight is: the mesh has an outline or a shadow in the wrong place there.
        unknown: Roughness given to what the views say nothing about.
        reading_error: Error of the best of readings.
        spread: How far paints differ in roughness, within one scene and from scene to scene.
        alike: Distance of patches, in log albedo and place in the unit frame, over which they tell
            of each other.
    """

    levels: Annotated[tuple[float, ...], Within(0.05, 0.99)] = (
        *(0.12, 0.2, 0.3, 0.42),
        *(0.56, 0.72, 0.9),
    )
    rough_share: Annotated[float, Within(0, 1)] = 0.66
    narrow: Annotated[int, Within(0, 100)] = 4
    least_roughness: Annotated[float, Within(0.01, 0.5)] = 0.1
    step: Annotated[float, Within(0.001, 0.1)] = 0.02
    fewest_views: Annotated[int, Within(1, 100_000)] = 30
    half_believed: Annotated[int, Within(0, 1_000_000)] = 300
    steepness: Annotated[float, Within(0, 1000)] = 12.0
    peak_error: Annotated[float, Within(0.01, 100)] = 0.25
    unseen_codes: Annotated[float, Within(0.001, 100, "codes")] = 0.3
    peak_codes: Annotated[float, Within(0.001, 100, "codes")] = 1.0
    top_share: Annotated[float, Within(0, 1)] = 0.03
    steady_share: Annotated[float, Within(0.01, 1)] = 0.8
    unknown: Annotated[float, Within(0.05, 1)] = 0.5
    reading_error: Annotated[float, Within(0.001, 1)] = 0.05
    spread: Annotated[float, Within(0.001, 10)] = 0.3
    alike: Annotated[float, Within(0.001, 100)] = 1.0

    def __post_init__(self) -> None:
        """Refuse levels that do not rise."""
        if not self.levels or list(self.levels) != sorted(set(self.levels)):
            raise ConfigError(
                f"appearance.material.highlights.levels is {list(self.levels)}; each must be above "
                "the one before"
            )


@dataclass(frozen=True, slots=True, kw_only=True)
class RoughnessConfig:
    """How many roughnesses there are.

    Attributes:
        no_difference: Deviation of the roughness over the surface below which there is one: nobody
            sees it, and chance alone lets patches predict a little better.
        stride: Every so manieth sample of paint is tried.
    """

    no_difference: Annotated[float, Within(0, 1)] = 0.04
    stride: Annotated[int, Within(1, 1000)] = 3


@dataclass(frozen=True, slots=True, kw_only=True)
class GlossConfig:
    """Which samples belong together, and what reflects the sky.

    Attributes:
        normal_scale: Distance, unit frame, that half the difference of opposite normals counts as
            between samples that are judged together.
        paint_scale: The same of a difference of one in the logarithm of albedo, as of paint: a
            small part of metal is judged with itself, not with the paint about it.
        spread_scale: Difference of log albedo that one of the deviation of views counts as.
        sharpest_sky: Roughness of the sky's reflection beside sharper highlights: what a sharper
            one would show of the sky and of the surroundings, their errors and the mesh's displace.
    """

    normal_scale: Annotated[float, Within(0, 10)] = 0.06
    paint_scale: Annotated[float, Within(0, 10)] = 0.05
    spread_scale: Annotated[float, Within(0, 100)] = 1.5
    sharpest_sky: Annotated[float, Within(0.05, 1)] = 0.5


@dataclass(frozen=True, slots=True, kw_only=True)
class MetalConfig:
    """When a surface is taken for metal, and what of.

    The first four are a logistic regression of true metal on what is measured of a neighbourhood,
    of 24 drawn captures for development, eleven of them with metal, each capture and either class
    counting alike.

    Attributes:
        per_paint_error: Log odds per logarithm of the display error, codes, that paint leaves.
        per_metal_error: The same of metal's error over paint's.
        per_brightness: The same of bright metal's error over that of any.
        constant: Log odds where all these are 0.
        least_ratio: Metal's error over paint's below which less tells no more.
        most_odds: Log odds, either way, that one neighbourhood may tell.
        num_levels: How many of the roughnesses metal is tried at: a rougher one looks like a
            dielectric of another shade.
        judged: Samples that are judged; the others go by those about them.
        neighbours: Of these, those that judge together under one roughness.
        witnesses: Of these, those whose log odds are averaged.
        likely: Log odds from which a sample may be part of metal.
        certain: Mean log odds from which such a part is metal: paint that is taken for metal costs
            a good albedo more than metal that is missed costs a bad one.
        gap: Gap, in spacings of the judged samples, across which samples belong to one part.
        fewest: Judged samples of a part.
        brightest_channel: Brightest channel that bright metal has at least.
        enough: Judged samples whose own errors are as large as what those of a part have in common.
        brightness: Usual log of a base colour's brightest channel.
        brightness_spread: Its standard deviation among metals.
        blue: Usual log of blue over red of a base colour.
        blue_spread: Its standard deviation; from silver to gold and copper.
        green_spread: Of the log of green over the mean of red and blue.
        alike: Spread among the metals of one scene, over that among all metals.
        brightness_error: Of a part's reading, in logarithms.
        blue_error: The same of its blue over red: light differs along the line of daylight.
        green_error: The same across it.
        misread_share: Chance that a reading is wrong altogether, for what is mirrored is.
        misread_error: Error of such a reading, in logarithms.
        solved_without: Least share of paint with which the light is solved by paint alone.
    """

    per_paint_error: Annotated[float, Within(-20, 20)] = 1.4
    per_metal_error: Annotated[float, Within(-20, 20)] = -2.98
    per_brightness: Annotated[float, Within(-20, 20)] = -1.26
    constant: Annotated[float, Within(-20, 20)] = -1.3
    least_ratio: Annotated[float, Within(0.001, 1)] = 0.35
    most_odds: Annotated[float, Within(0.1, 100)] = 4.0
    num_levels: Annotated[int, Within(1, 100)] = 5
    judged: Annotated[int, Within(100, 100_000)] = 3400
    neighbours: Annotated[int, Within(1, 1000)] = 8
    witnesses: Annotated[int, Within(1, 1000)] = 12
    likely: Annotated[float, Within(-20, 20)] = 0.5
    certain: Annotated[float, Within(-20, 20)] = 2.45
    gap: Annotated[float, Within(0.1, 100, "spacings")] = 3.0
    fewest: Annotated[int, Within(1, 100_000)] = 8
    brightest_channel: Annotated[float, Within(0.01, 1)] = 0.5
    enough: Annotated[float, Within(0, 1e6)] = 8.0
    brightness: Annotated[float, Within(-3, 0)] = -0.35
    brightness_spread: Annotated[float, Within(0.01, 3)] = 0.35
    blue: Annotated[float, Within(-3, 3)] = -0.35
    blue_spread: Annotated[float, Within(0.01, 3)] = 0.6
    green_spread: Annotated[float, Within(0.01, 3)] = 0.25
    alike: Annotated[float, Within(0.01, 1)] = 0.4
    brightness_error: Annotated[float, Within(0.01, 3)] = 0.35
    blue_error: Annotated[float, Within(0.01, 3)] = 0.45
    green_error: Annotated[float, Within(0.01, 3)] = 0.1
    misread_share: Annotated[float, Within(0, 1)] = 0.15
    misread_error: Annotated[float, Within(0.01, 10)] = 1.5
    solved_without: Annotated[float, Within(0, 1)] = 0.1


@dataclass(frozen=True, slots=True, kw_only=True)
class SegmentsConfig:
    """When samples that touch are two things.

    Attributes:
        clear_gap: Ashman's distance of two halves' means, in their mean deviations, from which they
            are two hues. Hues spread evenly along a line have 3.5 when cut in the middle, a normal
            distribution 2.7.
    """

    clear_gap: Annotated[float, Within(0, 1000)] = 4.0


@dataclass(frozen=True, slots=True, kw_only=True)
class MaterialConfig:
    """How gloss and metal are found.

    Attributes:
        reflections: What samples reflect.
        observed: What photographs show of it.
        highlights: Roughness by highlights.
        roughness: How many roughnesses there are.
        gloss: Samples that belong together.
        metal: What is metal.
        segments: When samples that touch are two things.
    """

    reflections: ReflectionsConfig = field(default_factory=ReflectionsConfig)
    observed: ObservedConfig = field(default_factory=ObservedConfig)
    highlights: HighlightsConfig = field(default_factory=HighlightsConfig)
    roughness: RoughnessConfig = field(default_factory=RoughnessConfig)
    gloss: GlossConfig = field(default_factory=GlossConfig)
    metal: MetalConfig = field(default_factory=MetalConfig)
    segments: SegmentsConfig = field(default_factory=SegmentsConfig)

    @property
    def metal_levels(self) -> tuple[float, ...]:
        """Roughnesses at which metal is tried."""
        return self.highlights.levels[: self.metal.num_levels]
