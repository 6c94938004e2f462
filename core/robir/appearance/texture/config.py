# SPDX-License-Identifier: Apache-2.0
"""Settings of the textures."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated

from robir.settings import Within


@dataclass(frozen=True, slots=True, kw_only=True)
class TexelSizeConfig:
    """How many texels there are at most.

    Attributes:
        most_together: Along a side of an atlas of UDIM tiles: what memory is planned for.
    """

    most_together: Annotated[int, Within(1024, 65536, "texels")] = 8192


@dataclass(frozen=True, slots=True, kw_only=True)
class TexelsConfig:
    """How values come from samples to texels.

    Attributes:
        min_albedo: Least albedo of a texel.
        max_albedo: Largest.
        normal_scale: How far apart two opposite normals count in searches for neighbours, half of
            it, unit frame.
        least_distance: Of a sample from a texel, spacings of the samples; adds to the distance
            whose inverse square says what the sample counts.
        step: Every so manieth texel stands for its neighbours where texels are compared with each
            other or normals are turned: the atlas is finer than photographs and mesh.
    """

    min_albedo: Annotated[float, Within(1e-5, 0.1)] = 0.002
    max_albedo: Annotated[float, Within(0.2, 1)] = 0.95
    normal_scale: Annotated[float, Within(0, 10)] = 0.15
    least_distance: Annotated[float, Within(0.001, 100)] = 0.2
    step: Annotated[int, Within(1, 64)] = 4


@dataclass(frozen=True, slots=True, kw_only=True)
class AlbedoConfig:
    """How albedo is read and how well it is known.

    Attributes:
        least_paint: Least share of a texel's radiance that is the paint's below a specular layer.
        dim_share: Irradiance that hardly tells albedo, over the mean of all texels.
        view_error: Error of log albedo that all views have in common.
        edge_error: The same at a shadow's edge.
        gloss_error: Error of the specular light that is subtracted, over itself: little is known of
            a dark material in the shade, most of whose light is reflected.
    """

    least_paint: Annotated[float, Within(0.001, 1)] = 0.1
    dim_share: Annotated[float, Within(1e-4, 1)] = 0.02
    view_error: Annotated[float, Within(0, 1)] = 0.05
    edge_error: Annotated[float, Within(0, 1)] = 0.25
    gloss_error: Annotated[float, Within(0, 10)] = 0.4


@dataclass(frozen=True, slots=True, kw_only=True)
class ShadowEdgesConfig:
    """Where nobody knows how much sun arrives, and which albedo is taken there.

    Attributes:
        ray_pairs: Pairs of opposite rays by which the share of a sun's wide lobe is told.
        least_share: Share of it from which a texel is at an edge, up to as little below 1.
        least_strength: Irradiance of a sun over that of the sky below which it casts no edge.
        mesh_error: Error of the mesh along the surface that a shadow may have, unit frame.
        brightest: Albedo that hardly anything exceeds: a texel in shadow that does was taken for
            shaded wrongly.
        reference_step: Every so manieth certain texel is looked up, so that a few reach far.
        palette: Certain texels whose albedos one at an edge may have. The nearest few lie on one
            side of the uncertain band and lack the other paint of a border within it.
        num_shares: Shares of the sun that are tried, from none to all.
        traced_weight: Difference of log albedo, summed over the channels, that a share differing
            from the traced one by all of the sun is worth.
        clipped_palette: Certain texels about one that is clipped.
        clipped_quantile: Of their albedos, that it takes.
    """

    ray_pairs: Annotated[int, Within(1, 128)] = 6
    least_share: Annotated[float, Within(0, 0.5)] = 0.02
    least_strength: Annotated[float, Within(0, 100)] = 0.1
    mesh_error: Annotated[float, Within(0, 0.5)] = 0.02
    brightest: Annotated[float, Within(0.1, 10)] = 0.9
    reference_step: Annotated[int, Within(1, 256)] = 8
    palette: Annotated[int, Within(1, 1024)] = 128
    num_shares: Annotated[int, Within(2, 1001)] = 11
    traced_weight: Annotated[float, Within(0, 100)] = 0.3
    clipped_palette: Annotated[int, Within(1, 1024)] = 8
    clipped_quantile: Annotated[float, Within(0, 1)] = 0.8


@dataclass(frozen=True, slots=True, kw_only=True)
class ResidualShadingConfig:
    """How albedo is freed of what errors of mesh and light leave in it.

    Attributes:
        mesh_error: Length over which errors of the mesh's normals vary, unit frame.
        reach: How far the surroundings reach that a texel is compared with, unit frame.
        count: Texels of these.
        rounds: How often texels are drawn together.
        alike_brightness: Difference of log albedo within which texels may be one material.
        alike_hue: The same in hue.
        hue_doubt: Standard deviation of a texel's hue against that of its brightness: how much sun
            arrives, which nobody knows at a shadow's edge, changes the one more than the other.
        least_doubt: Adds to the standard deviation of every log albedo where texels are weighed.
        blurred: Texels over which corrections are blurred at most.
    """

    mesh_error: Annotated[float, Within(1e-4, 0.5)] = 0.02
    reach: Annotated[float, Within(0, 4)] = 0.4
    count: Annotated[int, Within(2, 1024)] = 128
    rounds: Annotated[int, Within(0, 100)] = 3
    alike_brightness: Annotated[float, Within(0.01, 10)] = 0.35
    alike_hue: Annotated[float, Within(0.01, 10)] = 0.17
    hue_doubt: Annotated[float, Within(0, 10)] = 0.5
    least_doubt: Annotated[float, Within(0.001, 1)] = 0.03
    blurred: Annotated[int, Within(2, 1024)] = 12


@dataclass(frozen=True, slots=True, kw_only=True)
class UncertaintyConfig:
    """Standard error of log albedo by its causes; the factors are calibrated on drawn captures.

    Attributes:
        floor: What every texel has: light that is wrong makes whole sides of a thing wrong alike.
        spread: Factor of the standard error of the views about a texel's brightness.
        changed: Factor of how far albedo lay off its surroundings.
        few: Error by one view; falls with the square root of their number.
        distance: Of a texel that no view shows, per unit frame to the nearest seen one. Assumed,
            not calibrated: test views hardly show what no training view does.
    """

    floor: Annotated[float, Within(0, 1)] = 0.14
    spread: Annotated[float, Within(0, 100)] = 4.3
    changed: Annotated[float, Within(0, 100)] = 2.4
    few: Annotated[float, Within(0, 10)] = 0.19
    distance: Annotated[float, Within(0.1, 1000)] = 14.0


@dataclass(frozen=True, slots=True, kw_only=True)
class DetailConfig:
    """How photographs tell paint finer than the solved texels.

    Attributes:
        best_views: Whose detail is blended at a texel.
        steepness: Power of a view's pixels on a unit of surface by which it counts against others.
        depth_side: Longer side of the pictures by which is told what hides a texel.
        depth_tolerance: Difference of depth, unit frame, up to which a texel is the surface that a
            pixel sees.
        least_cosine: Views flatter than this blur all detail.
        most_detail: Of the logarithm of radiance: most that a spot may differ from its
            surroundings.
        disagreement: Difference of detail between views, natural logarithm, from which they count
            as disagreeing: a highlight's edge is in one of them only.
        rounds: How often the mean is found anew without those that disagree.
    """

    best_views: Annotated[int, Within(1, 16)] = 4
    steepness: Annotated[float, Within(0, 16)] = 4.0
    depth_side: Annotated[int, Within(16, 8192, "pixels")] = 400
    depth_tolerance: Annotated[float, Within(0, 1)] = 0.015
    least_cosine: Annotated[float, Within(0, 1)] = 0.3
    most_detail: Annotated[float, Within(0, 10)] = 1.5
    disagreement: Annotated[float, Within(0.001, 10)] = 0.1
    rounds: Annotated[int, Within(1, 100)] = 3


@dataclass(frozen=True, slots=True, kw_only=True)
class TexturingConfig:
    """How many photographs, far from each other, textures are read from.

    Attributes:
        albedo_views: Of which albedo is read.
        detail_views: Of which the best show a spot's detail.
    """

    albedo_views: Annotated[int, Within(1, 10000)] = 48
    detail_views: Annotated[int, Within(1, 10000)] = 96


@dataclass(frozen=True, slots=True, kw_only=True)
class TextureConfig:
    """How every texel is read.

    Attributes:
        texel_size: Texels at most.
        texels: From samples to texels.
        albedo: What paint is, and how well that is known.
        shadow_edges: Where nobody knows how much sun arrives.
        residual_shading: What errors of mesh and light leave in albedo.
        uncertainty: The error that is stated.
        detail: Paint finer than the solved texels.
    """

    texel_size: TexelSizeConfig = field(default_factory=TexelSizeConfig)
    texels: TexelsConfig = field(default_factory=TexelsConfig)
    albedo: AlbedoConfig = field(default_factory=AlbedoConfig)
    shadow_edges: ShadowEdgesConfig = field(default_factory=ShadowEdgesConfig)
    residual_shading: ResidualShadingConfig = field(default_factory=ResidualShadingConfig)
    uncertainty: UncertaintyConfig = field(default_factory=UncertaintyConfig)
    detail: DetailConfig = field(default_factory=DetailConfig)
