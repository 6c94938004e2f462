# SPDX-License-Identifier: Apache-2.0
"""Settings of the light: how suns are found and the sky is solved."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated

from robir.settings import Within


@dataclass(frozen=True, slots=True, kw_only=True)
class KnownPaintConfig:
    """How far a reading of paint that the user knows is believed.

    Attributes:
        read_error: Error of a spot's reading, of each channel's logarithm.
        sheen: What a white sheen adds to all channels of it.
        level_spread: Usual log by which albedo is off at all.
        hue_spread: Usual log by which each channel is off against the others: what white balance
            leaves.
    """

    read_error: Annotated[float, Within(1e-4, 1, "log units")] = 0.02
    sheen: Annotated[float, Within(0, 0.5, "albedo")] = 0.01
    level_spread: Annotated[float, Within(0, 10, "log units")] = 2.0
    hue_spread: Annotated[float, Within(0, 10, "log units")] = 0.1


@dataclass(frozen=True, slots=True, kw_only=True)
class LobesConfig:
    """How strengths of the light are solved: what albedos and lights commonly are.

    Weights are relative to the mean absolute difference of log albedo between neighbours.

    Attributes:
        mean_albedo: Geometric mean of the albedos of common scenes.
        start_albedo: Median albedo under the light that a search begins with.
        brightest_quantile: Rank of the albedos that counts as the brightest.
        brightest: Albedo that the brightest materials should not exceed.
        bounds: Weight of staying within a physical range.
        hue: Weight of hues that lights have (maths/daylight.py), per squared deviation: of the
            light as a whole, since surfaces that do not shine do not tell it from that of all
            albedos, and under a tint bounced light is judged wrongly; and of suns against the sky.
        part: The same of the sky's lobes against their mean, per deviation.
        smooth: Weight of neighbouring soft lobes being alike.
        spread: Weight of no bright soft lobes where few samples see them, as below the ground. They
            could else be as bright as it takes to shade what is painted.
        shadow: Weight of equal albedo on both sides of a shadow.
        rate: Learning rate of the first step; it falls to a tenth.
    """

    mean_albedo: Annotated[float, Within(0.01, 1)] = 0.3
    start_albedo: Annotated[float, Within(0.01, 1)] = 0.35
    brightest_quantile: Annotated[float, Within(0.5, 1)] = 0.97
    brightest: Annotated[float, Within(0.05, 2)] = 0.9
    bounds: Annotated[float, Within(0, 100)] = 1.0
    hue: Annotated[float, Within(0, 10)] = 0.0024
    part: Annotated[float, Within(0, 10)] = 0.005
    smooth: Annotated[float, Within(0, 10)] = 0.01
    spread: Annotated[float, Within(0, 10)] = 0.1
    shadow: Annotated[float, Within(0, 100)] = 0.25
    rate: Annotated[float, Within(1e-4, 1)] = 0.06


@dataclass(frozen=True, slots=True, kw_only=True)
class ProblemConfig:
    """What is known of a scene under a tone curve.

    Attributes:
        pair_reaches: Distances over which albedos are compared: below and above the width of a
            shadow.
        num_partners: Partners of a sample at each of these distances; with half as many the light
            hangs on chance.
        every_partners: The same where every sample takes part.
        sky_share: Radiance of a surface in the shade, open to the whole sky, over the median of
            what is seen.
        look_alikes: Seen samples that tell a hidden one's albedo, the nearest.
        look_alike_rank: Rank among them that does: the brighter ones are those in the light.
        least_hidden_albedo: Least albedo of what no camera sees.
        most_hidden_albedo: Greatest albedo of that.
        num_bounces: Reflections between surfaces that no camera sees.
        sun_ray_pairs: Pairs of opposite rays that sample a sun at a point.
    """

    pair_reaches: Annotated[tuple[float, float, float], Within(0.04, 2, "unit frame")] = (
        0.05,
        0.12,
        0.25,
    )
    num_partners: Annotated[int, Within(1, 100)] = 6
    every_partners: Annotated[int, Within(1, 100)] = 3
    sky_share: Annotated[float, Within(0, 10)] = 0.3
    look_alikes: Annotated[int, Within(1, 1000)] = 64
    look_alike_rank: Annotated[float, Within(0, 1)] = 0.9
    least_hidden_albedo: Annotated[float, Within(0, 0.5)] = 0.05
    most_hidden_albedo: Annotated[float, Within(0.5, 1)] = 0.8
    num_bounces: Annotated[int, Within(0, 50)] = 3
    sun_ray_pairs: Annotated[int, Within(1, 128)] = 4


@dataclass(frozen=True, slots=True, kw_only=True)
class ShadeConfig:
    """Which pairs across a shadow count, and how much.

    Attributes:
        alike_hue: Difference in hue, beyond the step common to all pairs, at which two samples
            hardly are one material.
        alike_brightness: The same in brightness. The fields of a board are .8 apart.
        light_error: Error of the irradiance that mesh and bounces leave, over its mean: what hardly
            any light reaches has an albedo that nobody knows.
    """

    alike_hue: Annotated[float, Within(0.005, 5, "log albedo")] = 0.1
    alike_brightness: Annotated[float, Within(0.005, 5, "log albedo")] = 0.35
    light_error: Annotated[float, Within(0, 2)] = 0.05


@dataclass(frozen=True, slots=True, kw_only=True)
class SolverConfig:
    """The last solve of strengths, shadows deciding between sky and suns.

    Attributes:
        neighbour_hue: Difference in hue at which neighbours hardly are one paint, once a light is
            known. Sky and sun differ in hue as well, and the sky is not known well. From .1 to .4
            all gives about the same.
        shadow: Weight of equal albedo across shadows once a light tells which pairs are one
            material.
        smooth: Weight of an even sky where few albedos are asked for: a bright patch of sky would
            turn one material into another.
        far: Weight of equal albedo where the hue is one, anywhere on the surface. Suns and curve
            are found without: under a wrong curve it would make albedos alike as well.
    """

    neighbour_hue: Annotated[float, Within(0.005, 5, "log albedo")] = 0.2
    shadow: Annotated[float, Within(0, 100)] = 1.0
    smooth: Annotated[float, Within(0, 10)] = 0.05
    far: Annotated[float, Within(0, 100)] = 2.0


@dataclass(frozen=True, slots=True, kw_only=True)
class SunConfig:
    """How directions are scanned for suns, and searched from the best ones.

    Attributes:
        strengths: Irradiances of the sun at normal incidence over the mean of the base light, tried
            for each direction.
        lit: Visibility times cosine above which a sample is lit.
        least_lit: Samples that a sun lights, over those that the best placed one would. From below
            the ground only one side of what stands on it is lit, and the strength of such a light
            is whatever evens out the albedo there; the soft lobes carry it.
        blur: Radius of the candidates, spacings of the scan: none is stepped over.
        basin: Spacings of the scan within which a candidate must be the best.
        separation: Angle between two suns: directions nearer than that are the same light to the
            scan, and a further sun there would only repair shadows of a wrong mesh.
        num_rivals: Directions about a candidate that are compared anew by more samples: along a
            shadow that runs off the ground those of the scan may not tell a sun from a lower place.
        num_starts: Of these, how many the search begins from.
        num_rounds: Rings of the search.
        shrinking: Radius of a ring over that of the one before.
        smoothing: Radius about the best trial in which a paraboloid smooths the losses. They leap
            wherever a shadow's edge steps over a sample; the lowest alone is up to a degree aside.
    """

    strengths: Annotated[tuple[float, float, float, float], Within(0.01, 1000)] = (
        0.25,
        0.8,
        2.0,
        6.0,
    )
    lit: Annotated[float, Within(0, 0.9)] = 0.05
    least_lit: Annotated[float, Within(0, 1)] = 0.4
    blur: Annotated[float, Within(0.1, 5)] = 0.5
    basin: Annotated[float, Within(0, 20)] = 1.5
    separation: Annotated[float, Within(0, 1.5, "radians")] = 0.3
    num_rivals: Annotated[int, Within(0, 100)] = 12
    num_starts: Annotated[int, Within(1, 100)] = 3
    num_rounds: Annotated[int, Within(1, 20)] = 4
    shrinking: Annotated[float, Within(0.1, 1)] = 0.6
    smoothing: Annotated[float, Within(0.001, 0.3, "radians")] = 0.022


@dataclass(frozen=True, slots=True, kw_only=True)
class SunSearchConfig:
    """What makes a direction a sun.

    Attributes:
        least_shadow_gain: Share by which a further sharp lobe must lower the differences across its
            own shadow.
        least_gain: Share by which a sun must lower the neighbour loss; the first need not if its
            shadow shows.
        promising: Gain in the scan, over `least_gain`, that a further sun must have to be tried.
            With all lights solved anew a second lamp gains up to three times as much.
        second_best: Gain in the scan, over the best one's, that other candidates for the first sun
            must have.
        num_candidates: Directions of the scan that may be tried at most.
        search_reach: Radius of the first ring of the search, spacings of the scan.
        scan_samples: Surface samples that the scan compares.
        sharpness: Of a sun before its own is searched: about 1.3 degrees across.
        tried_sharpness: Of these the one is taken that fits best.
        alike_cosine: Cosine between the normals of pairs by which a sun is found and polished:
            where shadows lie tells its place, while what changes with the orientation, paint or
            what a metal mirrors, passes for shading.
        alike_albedo: Difference at which pairs hardly count when a sun is polished: more than a
            shadow in the wrong place makes, less than there is between the fields of a board.
        polish_partners: Pairs per sample and distance then, by all samples that two views see: by
            those of the solve alone they hang on chance.
        level_cosine: Cosine between the normals of those pairs. Nearly all of them lie on one level
            surface, where nothing but a shadow changes with the sun's direction.
        polish_reach: Radius of the first ring of the search then.
    """

    least_shadow_gain: Annotated[float, Within(-1, 0.9)] = 0.15
    least_gain: Annotated[float, Within(0, 0.9)] = 0.02
    promising: Annotated[float, Within(0, 10)] = 0.25
    second_best: Annotated[float, Within(0, 1)] = 0.1
    num_candidates: Annotated[int, Within(1, 50)] = 3
    search_reach: Annotated[float, Within(0.05, 5)] = 0.8
    scan_samples: Annotated[int, Within(100, 100000)] = 2000
    sharpness: Annotated[float, Within(10, 1000000)] = 2000.0
    tried_sharpness: Annotated[tuple[float, float, float, float], Within(10, 1000000)] = (
        100.0,
        400.0,
        2000.0,
        10000.0,
    )
    alike_cosine: Annotated[float, Within(-1, 0.99)] = 0.8
    alike_albedo: Annotated[float, Within(0.01, 10, "log albedo")] = 1.0
    polish_partners: Annotated[int, Within(1, 100)] = 4
    level_cosine: Annotated[float, Within(-1, 0.99)] = 0.95
    polish_reach: Annotated[float, Within(0.001, 0.3, "radians")] = 0.03


@dataclass(frozen=True, slots=True, kw_only=True)
class SunlightConfig:
    """Where suns shine for sure.

    Attributes:
        edge_sharpness: Lobe in which a sun's visibility must be whole or nil for a point to be
            certain of it: 250 are 5 degrees across, about what a mesh error of one grid cell does
            to a shadow.
        edge_share: Share of that lobe that may be missing, or seen, of what counts as whole or nil.
        grazing_cosine: Cosine to a sun, of either sign, below which an error of the normals gives
            or takes that sun: 12 degrees; those of a draft are 7 to 10 off on average.
        facing_cosine: Cosine to a sun from which a sample is compared across its shadow.
    """

    edge_sharpness: Annotated[float, Within(10, 100000)] = 250.0
    edge_share: Annotated[float, Within(0, 0.45)] = 0.03
    grazing_cosine: Annotated[float, Within(0, 0.9)] = 0.2
    facing_cosine: Annotated[float, Within(0, 0.9)] = 0.15


@dataclass(frozen=True, slots=True, kw_only=True)
class LightConfig:
    """How suns are found and the sky is solved.

    Attributes:
        known_paint: How far a reading of known paint is believed.
        lobes: How strengths are solved.
        problem: What is known of a scene.
        shade: Which pairs across a shadow count.
        solver: The last solve.
        sun: How directions are scanned and searched.
        sun_search: What makes a direction a sun.
        sunlight: Where suns shine for sure.
    """

    known_paint: KnownPaintConfig = field(default_factory=KnownPaintConfig)
    lobes: LobesConfig = field(default_factory=LobesConfig)
    problem: ProblemConfig = field(default_factory=ProblemConfig)
    shade: ShadeConfig = field(default_factory=ShadeConfig)
    solver: SolverConfig = field(default_factory=SolverConfig)
    sun: SunConfig = field(default_factory=SunConfig)
    sun_search: SunSearchConfig = field(default_factory=SunSearchConfig)
    sunlight: SunlightConfig = field(default_factory=SunlightConfig)
