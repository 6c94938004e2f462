# SPDX-License-Identifier: Apache-2.0
"""Settings of what is done with a mesh that the user hands in."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated

from robir.settings import Within


@dataclass(frozen=True, slots=True, kw_only=True)
class PlacingConfig:
    """How a mesh is held against the masks, and how a better place is looked for.

    Attributes:
        views: Photographs that are looked at.
        coarse_side: Pixels along a photograph's longer side that are looked at to search.
        fine_side: The same to judge.
        pad: Of a photograph's sides: how far beyond its cut the mesh is looked for as well.
        turns: Turns of all kinds that are tried; 500 are about 25 degrees from each other.
        followed: Of them, those that are followed downhill.
        balances: How often each is scaled and shifted to suit the masks where its size is not
            known.
        first_turn: First step of a search downhill, about each axis.
        first_scale: The same of the size, its logarithm.
        first_shift: The same along each axis.
        evaluations: Places that such a search looks at.
        nearly: Share of outline and mask that both have from which a mesh stands nearly right, and
            what is off is followed from there.
        fits: Share from which it stands right; of its own masks a mesh of ours has .97.
        better: By how much more of that another place has to have to be believed.
    """

    views: Annotated[int, Within(2, 1000)] = 12
    coarse_side: Annotated[int, Within(8, 1000, "pixels")] = 28
    fine_side: Annotated[int, Within(8, 1000, "pixels")] = 80
    pad: Annotated[float, Within(0, 5)] = 0.5
    turns: Annotated[int, Within(1, 10_000)] = 500
    followed: Annotated[int, Within(1, 1000)] = 5
    balances: Annotated[int, Within(0, 20)] = 2
    first_turn: Annotated[float, Within(0.001, 1, "radians")] = 0.15
    first_scale: Annotated[float, Within(0.001, 1)] = 0.1
    first_shift: Annotated[float, Within(0.001, 1, "unit frame")] = 0.08
    evaluations: Annotated[int, Within(20, 10_000)] = 250
    nearly: Annotated[float, Within(0, 1)] = 0.5
    fits: Annotated[float, Within(0, 1)] = 0.9
    better: Annotated[float, Within(0, 1)] = 0.05


@dataclass(frozen=True, slots=True, kw_only=True)
class SymmetryConfig:
    """How turns are told that outlines hardly tell apart.

    Attributes:
        turns: Turns about an axis, the mesh's own among them.
        alike: Share of outline and mask that a turn may cost, before it is followed downhill, to be
            one that masks hardly tell: those that are guessed are wrong by about as much.
        told: The same after that, from which outlines tell in any case.
        sure: Standard errors over the photographs from which outlines tell by less than that as
            well.
        followed: Turns that are followed.
        reach: Of the first steps of a search downhill; what is followed by fine outlines is nearly
            right.
        apart: Angle by which turns differ at least that count as two.
    """

    turns: Annotated[int, Within(2, 360)] = 12
    alike: Annotated[float, Within(0, 1)] = 0.04
    told: Annotated[float, Within(0, 1)] = 0.02
    sure: Annotated[float, Within(0, 100)] = 3.0
    followed: Annotated[int, Within(0, 1000)] = 4
    reach: Annotated[float, Within(0.01, 1)] = 0.3
    apart: Annotated[float, Within(0.1, 180, "degrees")] = 15.0


@dataclass(frozen=True, slots=True, kw_only=True)
class VerdictConfig:
    """What the share of outline and mask that both have means.

    Attributes:
        unrelated: Below which a mesh shows something else.
        most_apart: Share of the masks that a mesh within them may lack, or of it that may lie
            beyond them all.
        likely: That a place has at least which is proposed.
        aligns: From which cameras are believed to be where they were brought; meshes of other
            objects reach .8.
    """

    unrelated: Annotated[float, Within(0, 1)] = 0.5
    most_apart: Annotated[float, Within(0, 1)] = 0.8
    likely: Annotated[float, Within(0, 1)] = 0.75
    aligns: Annotated[float, Within(0, 1)] = 0.85


@dataclass(frozen=True, slots=True, kw_only=True)
class FitPictureConfig:
    """The picture of photographs with a mesh over them.

    Attributes:
        photographs: In a row of it.
        side: Longer side of each.
    """

    photographs: Annotated[int, Within(1, 100)] = 4
    side: Annotated[int, Within(16, 4096, "pixels")] = 240


@dataclass(frozen=True, slots=True, kw_only=True)
class LayoutConfig:
    """Which texture coordinates of the user's are kept.

    Attributes:
        outside: Of a tile's side: as far as texture coordinates may leave it by rounding.
        overlap: Share of a tile's layout that may lie on itself: charts' rims do.
        smallest: Share of a tile below which a layout is none.
        atlas_side: Texels along a side by which a layout is judged, each tile by itself.
        most_tiles: Beyond which a texture would have too few texels of those that memory holds.
    """

    outside: Annotated[float, Within(0, 0.1)] = 1e-3
    overlap: Annotated[float, Within(0, 1)] = 0.03
    smallest: Annotated[float, Within(1e-6, 1)] = 1e-3
    atlas_side: Annotated[int, Within(64, 4096, "texels")] = 1024
    most_tiles: Annotated[int, Within(1, 1000)] = 100


@dataclass(frozen=True, slots=True, kw_only=True)
class NoiseConfig:
    """How the noise of a scan is measured and taken away.

    Attributes:
        calm: Share of the surface by which noise is measured: where it is calmest.
        sure: Standard errors of the correlation by which it must be below zero, and standard
            deviations beyond which a vertex counts as that far off.
        left: Error of a normal that the averaging leaves.
        like: Difference of two averaged normals that counts as one standard deviation.
        rounds: Of averaging; an edge that the first has blurred is back after some.
        neighbours: Faces at most that are averaged.
        steps: In which vertices follow the normals.
        farthest: Standard deviations of the noise by which a vertex moves at most.
        shape: Correlation between neighbours from which what was taken away is shape. It is below
            .06 for scans with noise, and above .2 for meshes that were decimated far.
    """

    calm: Annotated[float, Within(0.01, 0.99)] = 0.25
    sure: Annotated[float, Within(0.1, 100)] = 3.0
    left: Annotated[float, Within(0.001, 1, "radians")] = 0.05
    like: Annotated[float, Within(0.001, 10)] = 0.3
    rounds: Annotated[int, Within(1, 100)] = 5
    neighbours: Annotated[int, Within(2, 1000)] = 64
    steps: Annotated[int, Within(0, 1000)] = 20
    farthest: Annotated[float, Within(0, 100)] = 3.0
    shape: Annotated[float, Within(-1, 1)] = 0.1


@dataclass(frozen=True, slots=True, kw_only=True)
class OccludersConfig:
    """How what stands before the object is told.

    Attributes:
        side: Longer side at which photographs are compared.
        points: Of the surface, that are compared.
        least_views: Photographs that see a point, from which their median says what it looks like.
        least_cosine: To the normal, from which a photograph is believed.
        dark: Added to codes in [0, 1] before their log, so that noise in the dark is none there.
        noise: Least spread of that log.
        unlike: Spreads from the median that are something else.
        asked: Photographs that see a point which are asked about it.
        among: Of so many from the nearest directions.
        about: Angle from a photograph's direction up to which these are near.
        like: Of a photograph's distance from the median: one as near as that shows the same.
        share: Of the points about a place that must be something else.
        most: Of a photograph's points; above it this is no thing in front but another light or a
            wrong camera, or one so large that the photograph's exposure is told by it.
        blur: Width about such a place.
        thin: Points a pixel below which a place cannot be told.
        hidden: Distance within which that goes with a patch beside it.
        least_area: Of what a photograph shows of the object; smaller patches are gloss or an error
            of the mesh.
        grown: By which a patch grows: its rim is mixed with the object.
        lift: Distance above the surface at which rays begin.
    """

    side: Annotated[int, Within(16, 4096, "pixels")] = 160
    points: Annotated[int, Within(100, 1_000_000)] = 30_000
    least_views: Annotated[int, Within(1, 1000)] = 8
    least_cosine: Annotated[float, Within(0, 1)] = 0.35
    dark: Annotated[float, Within(0.0001, 1)] = 0.03
    noise: Annotated[float, Within(0.0001, 10)] = 0.04
    unlike: Annotated[float, Within(0.1, 1000)] = 5.0
    asked: Annotated[int, Within(0, 1000)] = 3
    among: Annotated[int, Within(0, 1000)] = 10
    about: Annotated[float, Within(0, 180, "degrees")] = 30.0
    like: Annotated[float, Within(0, 10)] = 0.5
    share: Annotated[float, Within(0, 1)] = 0.5
    most: Annotated[float, Within(0, 1)] = 0.5
    blur: Annotated[float, Within(0.1, 100, "pixels")] = 1.5
    thin: Annotated[float, Within(0, 100)] = 0.02
    hidden: Annotated[int, Within(1, 100, "pixels")] = 4
    least_area: Annotated[float, Within(0, 1)] = 0.008
    grown: Annotated[int, Within(1, 100, "pixels")] = 3
    lift: Annotated[float, Within(0, 0.1, "unit frame")] = 1e-3


@dataclass(frozen=True, slots=True, kw_only=True)
class ReadyConfig:
    """How a mesh is made ready for textures and light.

    Attributes:
        light_faces: Faces of the copy on which light is solved, over the face budget of a surface
            of our own.
        thinned: Faces, over those of that copy, to which a mesh of more is thinned quickly first.
        outward: Share of the faces whose normals are on the side of their front, in a mesh with a
            normal map.
        normal_scale: Distance that counts as much as two normals one unit apart.
    """

    light_faces: Annotated[int, Within(1, 1000)] = 4
    thinned: Annotated[int, Within(1, 1000)] = 8
    outward: Annotated[float, Within(0, 1)] = 0.99
    normal_scale: Annotated[float, Within(0, 10, "unit frame")] = 0.25


@dataclass(frozen=True, slots=True, kw_only=True)
class GivenConfig:
    """What is done with a mesh that the user hands in.

    Attributes:
        placing: Where the photographs show it.
        symmetry: Turns that outlines hardly tell apart.
        verdict: What its agreement with the masks means.
        fit_picture: The picture of that.
        layout: Its texture coordinates.
        noise: Its noise.
        ready: Normals, and the copy for light.
        occluders: What stands before it in photographs.
    """

    placing: PlacingConfig = field(default_factory=PlacingConfig)
    symmetry: SymmetryConfig = field(default_factory=SymmetryConfig)
    verdict: VerdictConfig = field(default_factory=VerdictConfig)
    fit_picture: FitPictureConfig = field(default_factory=FitPictureConfig)
    layout: LayoutConfig = field(default_factory=LayoutConfig)
    noise: NoiseConfig = field(default_factory=NoiseConfig)
    ready: ReadyConfig = field(default_factory=ReadyConfig)
    occluders: OccludersConfig = field(default_factory=OccludersConfig)
