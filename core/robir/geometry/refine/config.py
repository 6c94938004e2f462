# SPDX-License-Identifier: Apache-2.0
"""Settings of the mesh's refinement."""

from __future__ import annotations

from dataclasses import dataclass

from robir.errors import ConfigError


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
