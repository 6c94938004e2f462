# SPDX-License-Identifier: Apache-2.0
"""Settings of facets, of the number of triangles and of texture coordinates."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated

from robir.settings import Within


@dataclass(frozen=True, slots=True, kw_only=True)
class ChartsConfig:
    """How texture coordinates are packed.

    Attributes:
        atlas_size: Of the atlas the charts are packed for; sets the gutter between them.
        gutter: Between charts in that atlas.
        most_cost: Of a chart, as xatlas counts it: more makes larger charts of more distortion.
    """

    atlas_size: Annotated[int, Within(64, 16384, "pixels")] = 1024
    gutter: Annotated[int, Within(0, 64, "pixels")] = 3
    most_cost: Annotated[float, Within(0.1, 1000)] = 8.0


@dataclass(frozen=True, slots=True, kw_only=True)
class FacetsConfig:
    """What counts as a flat part of a surface, and what is moved onto its plane.

    Attributes:
        near: Largest distance of a facet's own vertices from its plane.
        tilt: Largest angle between their normals and the plane's.
        least_side: A facet is at least as large as a square of this side.
        least_piece: Least area of a connected piece of a facet, in such squares.
        most_facets: Facets that are looked for.
        most_failures: Candidates that may fail before the search ends.
        seeds: Vertices that propose a plane.
        voters: Vertices that vote on each.
        normal_passes: How often normals are averaged with the neighbours' for the search.
        fits: How often a plane is fitted to its members.
        rough: Largest root mean square distance of the facet's vertices from the plane.
        bowed: Largest root mean square height of a paraboloid fitted to these distances.
        escape: Most area, against the facet's, of what leaves its plane nearby while its normal is
            still near the plane's: more of that means a curved surface.
        escape_rings: Rings of neighbours that are looked at for it.
        escape_tilt: Largest angle between its normals and the plane's.
        reach: Distance from the plane within which vertices are moved onto it: the cut-off edges.
        reach_rings: Rings of neighbours of the facet within which they lie.
        reach_tilt: Largest angle between their normals and the plane's.
        reach_passes: How often these normals are averaged with the neighbours'.
        limit: Vertices that would move further than this stay.
        same_side: Of planes whose normals have a larger cosine, only the nearest claims a vertex.
    """

    near: Annotated[float, Within(0.05, 5, "cells")] = 0.75
    tilt: Annotated[float, Within(1, 80, "degrees")] = 20.0
    least_side: Annotated[float, Within(1, 200, "cells")] = 12.0
    least_piece: Annotated[float, Within(0, 1)] = 0.25
    most_facets: Annotated[int, Within(0, 1000)] = 30
    most_failures: Annotated[int, Within(1, 1000)] = 30
    seeds: Annotated[int, Within(1, 1000)] = 150
    voters: Annotated[int, Within(1, 100_000)] = 5000
    normal_passes: Annotated[int, Within(0, 50)] = 6
    fits: Annotated[int, Within(0, 50)] = 4
    rough: Annotated[float, Within(0, 5, "cells")] = 0.33
    bowed: Annotated[float, Within(0, 5, "cells")] = 0.12
    escape: Annotated[float, Within(0, 10)] = 0.5
    escape_rings: Annotated[int, Within(0, 50)] = 6
    escape_tilt: Annotated[float, Within(1, 89, "degrees")] = 45.0
    reach: Annotated[float, Within(0, 10, "cells")] = 1.7
    reach_rings: Annotated[int, Within(0, 50)] = 3
    reach_tilt: Annotated[float, Within(1, 89, "degrees")] = 60.0
    reach_passes: Annotated[int, Within(0, 50)] = 2
    limit: Annotated[float, Within(0, 20, "cells")] = 2.0
    same_side: Annotated[float, Within(-1, 1)] = 0.5


@dataclass(frozen=True, slots=True, kw_only=True)
class SimplifyConfig:
    """How triangles are made fewer, and where normals part.

    Attributes:
        crease: Faces that meet at a sharper angle do not share a normal.
        share_left: Share of the faces that one pass of decimation leaves.
        aggression: How steeply the library raises its threshold; low keeps edges, and stalls far
            from the aim.
    """

    crease: Annotated[float, Within(0, 180, "degrees")] = 40.0
    share_left: Annotated[float, Within(0.05, 0.95)] = 0.5
    aggression: Annotated[float, Within(3, 20)] = 3.0


@dataclass(frozen=True, slots=True, kw_only=True)
class UnwrapConfig:
    """The patience with texture coordinates.

    Attributes:
        clock_factor: Seconds of the clock that a second of processor time may take on a busy
            machine.
    """

    clock_factor: Annotated[int, Within(1, 10_000)] = 8


@dataclass(frozen=True, slots=True, kw_only=True)
class MeshConfig:
    """From a dense surface to the mesh that carries a texture.

    Attributes:
        charts: How texture coordinates are packed.
        facets: Flat parts.
        simplify: Fewer triangles, and creases.
        unwrap: The patience with texture coordinates.
    """

    charts: ChartsConfig = field(default_factory=ChartsConfig)
    facets: FacetsConfig = field(default_factory=FacetsConfig)
    simplify: SimplifyConfig = field(default_factory=SimplifyConfig)
    unwrap: UnwrapConfig = field(default_factory=UnwrapConfig)
