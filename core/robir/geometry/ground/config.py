# SPDX-License-Identifier: Apache-2.0
"""Settings of the ground that an object stands on: its plane, its columns, its picture."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated

from robir.settings import Within


@dataclass(frozen=True, slots=True, kw_only=True)
class PlaneConfig:
    """How a flat ground is told by the rim that the masks show of it.

    Attributes:
        contour_points: Outline points used of a photograph.
        ray_steps: Steps along an outline point's ray through the bounding sphere.
        near_hull: How much deeper than the deepest point of such a ray another may lie to belong to
            the stretch that touches.
        longest_stretch: Length of that stretch up to which its middle is a touching point.
        least_touching: Touching points that a plane is looked for among.
        least_agreeing: Points that must lie in a plane, and on its upper edge to be fitted to that.
        trials: Planes through three points that are tried.
        tolerance: Distance from a plane up to which points speak for it.
        least_in_front: Share of the cameras that must be on the plane's one side.
        least_upward: Part of an outline's normal along the plane's, above which the outline is that
            of the upper edge.
        fit_width: Distance from the upper edge at which a point counts as stray.
        fit_rounds: Solutions, each with the weights by the one before.
        rim_width: Distance from the plane up to which points belong to its outline.
        widest_gap: Angle about the middle that the rim may leave open.
        least_share: Of the hull that must stand on the outline, and of the outline's pictures that
            the masks must hold.
        outline_growth: Size, against the outline, of what the hull must stand on.
    """

    contour_points: Annotated[int, Within(12, 10_000)] = 120
    ray_steps: Annotated[int, Within(16, 4000)] = 240
    near_hull: Annotated[float, Within(0, 10, "cells")] = 0.6
    longest_stretch: Annotated[float, Within(0.01, 2, "unit frame")] = 0.12
    least_touching: Annotated[int, Within(3, 100_000)] = 100
    least_agreeing: Annotated[int, Within(3, 100_000)] = 60
    trials: Annotated[int, Within(1, 100_000)] = 600
    tolerance: Annotated[float, Within(0.01, 10, "cells")] = 0.5
    least_in_front: Annotated[float, Within(0, 1)] = 0.9
    least_upward: Annotated[float, Within(-1, 1)] = 0.5
    fit_width: Annotated[float, Within(0.01, 10, "cells")] = 0.4
    fit_rounds: Annotated[int, Within(1, 100)] = 10
    rim_width: Annotated[float, Within(0.01, 10, "cells")] = 1.2
    widest_gap: Annotated[float, Within(0, 360, "degrees")] = 60.0
    least_share: Annotated[float, Within(0, 1)] = 0.97
    outline_growth: Annotated[float, Within(0.5, 2)] = 1.04


@dataclass(frozen=True, slots=True, kw_only=True)
class FarEdgeConfig:
    """How the height of a ground follows from its far edge.

    Attributes:
        knots: Points between which the edge's distance from the middle is linear in the angle about
            it.
        stiffness: Weight of the difference between neighbouring knots against one ray.
        least_rise: Upward part of an outline's outward normal; upright things and near edges, below
            which the ground shows its side, have less.
        least_fall: Downward part of a ray's direction; flatter ones meet the plane anywhere.
        least_along: Cosine between an outline's normal, within the plane, and the direction from
            the middle; outlines of what stands before the edge run across it.
        rounds: Linear solutions.
        wide_rounds: How many of them take rays at the full width.
        narrowing: Share of the width at which a ray counts as stray in the others.
        rays_a_knot: Rays that must agree on the edge, for each knot.
    """

    knots: Annotated[int, Within(4, 400)] = 36
    stiffness: Annotated[float, Within(0, 100)] = 0.3
    least_rise: Annotated[float, Within(0, 1)] = 0.3
    least_fall: Annotated[float, Within(0.001, 1)] = 0.05
    least_along: Annotated[float, Within(0, 1)] = 0.9
    rounds: Annotated[int, Within(1, 100)] = 10
    wide_rounds: Annotated[int, Within(0, 100)] = 3
    narrowing: Annotated[float, Within(0.01, 1)] = 0.35
    rays_a_knot: Annotated[int, Within(0, 100)] = 5


@dataclass(frozen=True, slots=True, kw_only=True)
class PhotoConsistencyConfig:
    """How photographs tell by colours what ground is.

    Attributes:
        least_views: Photographs that must see a spot before it is judged.
        same_colour: Mean difference of display colours up to which they count as the same.
        lead: By how much less photographs must differ, display, about a surface than about the foot
            below it for the surface to be believed: a plate's rim is, what is left before bare
            ground not.
        taller: By how much what hides a spot must be higher than the surface over the spot's own
            column, in steps between columns. A plate's rim hides the ground beside it, and a lump
            left beside the rim must not be asked by photographs that see the rim; but lumps do not
            speak for each other.
        line_steps: Steps of the line from a spot to a camera that may be hidden.
        least_coverage: Above which a mask holds a spot.
        dark: Added to display colours before their hue is taken, which is noise in the dark.
    """

    least_views: Annotated[int, Within(1, 100)] = 4
    same_colour: Annotated[float, Within(0.001, 1)] = 0.06
    lead: Annotated[float, Within(0, 1)] = 0.01
    taller: Annotated[float, Within(0, 100)] = 2.0
    line_steps: Annotated[int, Within(2, 1000)] = 40
    least_coverage: Annotated[float, Within(0, 0.99)] = 0.9
    dark: Annotated[float, Within(0.0001, 1)] = 0.02


@dataclass(frozen=True, slots=True, kw_only=True)
class FlattenConfig:
    """Which columns are ground, and how it is made flat.

    Attributes:
        highest: Height above the plane up to which columns are searched for a surface.
        standing: Height from which columns are objects whatever their foot would look like.
        highest_lens: Height up to which the hull of bare ground is searched.
        lens_slack: Height over that hull up to which masks hold no evidence of anything.
        flat: Distance from the plane up to which a column's surface is the plane.
        speck: Columns of the largest doubtful piece that joins the ground enclosing it.
        rim: Size of the part of the outline, towards its middle, that must prove to be ground.
        deepest: How far below the plane half of a ground may lie once a level is fitted. What is
            flat came out between .4 and .5 above it at the first level, a plate at -.4.
        bumpy: Distance from the plane within which a surface may be ground that the fit left bumpy.
        bumpy_gain: Times as many columns as are ground for certain from which that is asked.
    """

    highest: Annotated[float, Within(0.05, 2, "unit frame")] = 0.6
    standing: Annotated[float, Within(0, 2, "unit frame")] = 0.13
    highest_lens: Annotated[float, Within(0.01, 2, "unit frame")] = 0.3
    lens_slack: Annotated[float, Within(0, 10, "cells")] = 0.6
    flat: Annotated[float, Within(0, 10, "cells")] = 0.8
    speck: Annotated[int, Within(0, 10_000)] = 9
    rim: Annotated[float, Within(0.1, 1)] = 0.93
    deepest: Annotated[float, Within(0, 10, "cells")] = 0.2
    bumpy: Annotated[float, Within(0, 20, "cells")] = 4.0
    bumpy_gain: Annotated[float, Within(1, 100)] = 1.1


@dataclass(frozen=True, slots=True, kw_only=True)
class PixelRaysConfig:
    """Which pixels' rays are followed to the ground.

    Attributes:
        step: Every so many pixels are looked at where a sample will do, along rows and columns.
        least_coverage: Above which a pixel may show ground.
    """

    step: Annotated[int, Within(1, 16)] = 2
    least_coverage: Annotated[float, Within(0, 0.99)] = 0.95


@dataclass(frozen=True, slots=True, kw_only=True)
class BackdropConfig:
    """How the picture of the ground is found, and what is freed before it.

    Attributes:
        bins: Steps of a display channel in the palette of the ground.
        rarest: Share of the colours of certain ground that one step of the palette must have more
            of.
        darkest: Display value of the ground in deep shadow against that in light.
        shades: Shades from there to the light that the palette holds.
        spread: How far a pixel may lie outside the range of the ground's colours about its spot,
            display.
        noise_width: How far it may in any case, in standard deviations of the photographs' noise.
        noise_coverage: Above which a pixel tells of noise, for it shows nothing but what the mask
            encloses.
        least_views: Photographs that must show a spot of ground, and that must see through a freed
            point.
        least_share: Of a spot's photographs that must show ground there; things may hide it from
            the rest.
        doubt: Share of the pixels that reach a spot and show another colour at which it is no
            ground.
        hue: Difference of hue from the colours of certain ground beyond which a spot is no shaded
            ground.
        dim: Display value against that of certain ground below which hue tells nothing: most light
            that arrives below a thing comes from it and has its hue.
        least_hue: Share of certain ground that must have a hue: single columns may be certain
            wrongly.
        vote_reach: Nodes to each side whose photographs decide about a node with its own.
        rounds: How often the picture of the ground is checked against what was freed with it.
    """

    bins: Annotated[int, Within(4, 100)] = 20
    rarest: Annotated[float, Within(0, 0.1)] = 2e-4
    darkest: Annotated[float, Within(0, 1)] = 0.25
    shades: Annotated[int, Within(2, 200)] = 16
    spread: Annotated[float, Within(0, 1)] = 0.05
    noise_width: Annotated[float, Within(0, 20)] = 3.0
    noise_coverage: Annotated[float, Within(0, 0.999)] = 0.99
    least_views: Annotated[int, Within(1, 100)] = 3
    least_share: Annotated[float, Within(0, 1)] = 0.08
    doubt: Annotated[float, Within(0, 1)] = 0.25
    hue: Annotated[float, Within(0.001, 5)] = 0.08
    dim: Annotated[float, Within(0, 10)] = 0.35
    least_hue: Annotated[float, Within(1e-6, 1)] = 0.02
    vote_reach: Annotated[int, Within(0, 10)] = 2
    rounds: Annotated[int, Within(0, 10)] = 2


@dataclass(frozen=True, slots=True, kw_only=True)
class GroundConfig:
    """How the ground is found, flattened and taken as a backdrop.

    Attributes:
        image_side: Longer side of the photographs that tell the ground.
        plane: The flat ground by the rim that the masks show.
        far_edge: Its height.
        photo_consistency: What photographs say of columns.
        flatten: Which columns are ground.
        pixel_rays: Which pixels are looked at.
        backdrop: The ground's own picture.
    """

    image_side: Annotated[int, Within(32, 4096, "pixels")] = 200
    plane: PlaneConfig = field(default_factory=PlaneConfig)
    far_edge: FarEdgeConfig = field(default_factory=FarEdgeConfig)
    photo_consistency: PhotoConsistencyConfig = field(default_factory=PhotoConsistencyConfig)
    flatten: FlattenConfig = field(default_factory=FlattenConfig)
    pixel_rays: PixelRaysConfig = field(default_factory=PixelRaysConfig)
    backdrop: BackdropConfig = field(default_factory=BackdropConfig)
