# SPDX-License-Identifier: Apache-2.0
"""Settings of the mesh's refinement."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated

from robir.errors import ConfigError
from robir.settings import Within


@dataclass(frozen=True, slots=True, kw_only=True)
class CorrelationConfig:
    """Which photographs judge a vertex.

    Attributes:
        least_cosine: Between normal and view, from which a photograph judges it.
        border: Distance from a picture's border below which it judges nothing.
    """

    least_cosine: Annotated[float, Within(0.01, 0.99)] = 0.25
    border: Annotated[float, Within(0, 16, "pixels")] = 3.0


@dataclass(frozen=True, slots=True, kw_only=True)
class OutlinesConfig:
    """Which vertices lie on an outline.

    Attributes:
        grazing: Cosine between normal and view below which a vertex does.
        near: Distance of an outline in the picture up to which it is the vertex' own.
        clearance: Height above the surface at which rays along the view must be free on both sides.
    """

    grazing: Annotated[float, Within(0.001, 1)] = 0.2
    near: Annotated[float, Within(0.1, 100, "pixels")] = 3.0
    clearance: Annotated[float, Within(0, 100, "pixels")] = 2.5


@dataclass(frozen=True, slots=True, kw_only=True)
class StepConfig:
    """The mesh that is moved, and the search for its shifts.

    Attributes:
        fair_rounds: Rounds of Taubin smoothing before normals are taken: patches must be tilted as
            the surface is.
        most_edge: Length of the mesh's edges above which it is subdivided.
        loose: How far from the smooth surface a vertex may look at first: the weight of its
            distance, in reaches squared, is one over twice this, and doubles every round.
        most_iterations: Of conjugate gradients a round; each begins where the last one ended.
    """

    fair_rounds: Annotated[int, Within(0, 1000)] = 10
    most_edge: Annotated[float, Within(0.1, 1000, "pixels")] = 2.0
    loose: Annotated[float, Within(0.001, 1000)] = 0.5
    most_iterations: Annotated[int, Within(1, 10_000)] = 80


@dataclass(frozen=True, slots=True, kw_only=True)
class RefineConfig:
    """How the mesh is moved along its normals, level after level.

    Attributes:
        image_sides: Longer side of the photographs at each level, pixels.
        reach: Largest shift of a vertex, pixels of the level.
        offsets: Shifts that are tried, evenly over the reach on both sides.
        views: Most photographs that judge a vertex.
        window: Half side of the patches that are compared, pixels.
        noise: Standard deviation of display values that no texture explains.
        agreeing: Share of a vertex' photographs that must agree; the rest may be hidden by what
            the mesh lacks or hold a highlight.
        smoothness: Weight of the thin plate's bending against correlation.
        crease: Bend between neighbouring vertices at which a crease begins, pixels.
        anchor: Weight of the mesh as it was, at a shift of the whole reach.
        outline: Weight of the masks' outlines, likewise, each time one runs along a vertex.
        rounds: Rounds of search and smoothing.
        most_vertices: Vertices up to which the mesh is subdivided.
        face_budget: Most triangles of the result; up to that many photographs' pixels decide.
        correlation: Which photographs judge a vertex.
        outlines: Which vertices lie on an outline.
        step: The mesh that is moved, and the search for its shifts.
    """

    image_sides: tuple[int, ...] = (400, 800)
    reach: float = 5.0
    offsets: int = 21
    views: int = 8
    window: int = 3
    noise: float = 0.012
    agreeing: float = 0.6
    smoothness: float = 10.0
    crease: float = 0.3
    anchor: float = 0.01
    outline: float = 0.2
    rounds: int = 4
    most_vertices: int = 120_000
    face_budget: int = 24_000
    correlation: CorrelationConfig = field(default_factory=CorrelationConfig)
    outlines: OutlinesConfig = field(default_factory=OutlinesConfig)
    step: StepConfig = field(default_factory=StepConfig)

    def __post_init__(self) -> None:
        """Refuse values the step cannot work with."""
        for name, least in (("offsets", 3), ("views", 2), ("window", 1), ("rounds", 1)):
            if getattr(self, name) < least:
                raise ConfigError(
                    f"geometry.refine.{name} is {getattr(self, name)}; it must be at least {least}"
                )
        if not self.image_sides:
            raise ConfigError("geometry.refine.image_sides is empty; give one size at least")
        if not self.reach > 0 or not 0 < self.agreeing <= 1:
            raise ConfigError(
                f"geometry.refine.reach is {self.reach} and agreeing {self.agreeing}; they must be "
                "above 0, the second at most 1"
            )
