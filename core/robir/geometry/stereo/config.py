# SPDX-License-Identifier: Apache-2.0
"""Settings of the depth maps and of their fusion."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated

from robir.errors import ConfigError
from robir.settings import Within


@dataclass(frozen=True, slots=True, kw_only=True)
class FusionConfig:
    """Which maps speak for each other.

    Attributes:
        witness: Angle at the object up to which another photograph's depths can confirm or deny
            one.
    """

    witness: Annotated[float, Within(1, 180, "degrees")] = 40.0


@dataclass(frozen=True, slots=True, kw_only=True)
class SmoothestConfig:
    """The solution for the smoothest distances.

    Attributes:
        coarsest: Nodes along a side below which a grid is not halved any more.
        iterations: Of conjugate gradients on each grid; each begins with the solution on half of
            its nodes.
    """

    coarsest: Annotated[int, Within(4, 256)] = 12
    iterations: Annotated[int, Within(1, 10_000)] = 60


@dataclass(frozen=True, slots=True, kw_only=True)
class SourceChoiceConfig:
    """Which photographs a photograph is compared with.

    Attributes:
        narrow: Spread of angles below the wanted one that will do, as a share of it.
        wide: The same above it.
        apart: Angle between two sources at which they count as two, as a share of the wanted one.
        least_score: Sources that fit less are left out.
    """

    narrow: Annotated[float, Within(0.01, 10)] = 1 / 3
    wide: Annotated[float, Within(0.01, 10)] = 5 / 6
    apart: Annotated[float, Within(0.01, 10)] = 0.5
    least_score: Annotated[float, Within(0, 0.99)] = 0.02


@dataclass(frozen=True, slots=True, kw_only=True)
class SurfaceConfig:
    """What fused distances and the visual hull say together.

    Attributes:
        free: Share of the band's half width from which a distance says that a node is free, not how
            far.
        deep: Distance to the hull beyond which it says no more than inside or outside.
        outside: Weight of the visual hull where it says that there is nothing.
    """

    free: Annotated[float, Within(0, 1)] = 0.98
    deep: Annotated[float, Within(0.5, 100, "bands")] = 2.0
    outside: Annotated[float, Within(0.1, 1000)] = 1.0


@dataclass(frozen=True, slots=True, kw_only=True)
class SweepConfig:
    """The planes of a sweep.

    Attributes:
        fewest_planes: Planes of a sweep at least.
        most_planes: And at most.
        early: Matching cost of a depth before the visual hull: more than of any that disagrees.
        whole: Coverage from which a pixel is object, for the refinement too.
    """

    fewest_planes: Annotated[int, Within(3, 1024)] = 16
    most_planes: Annotated[int, Within(3, 1024)] = 128
    early: Annotated[float, Within(0, 10)] = 1.5
    whole: Annotated[float, Within(0.05, 0.999)] = 0.95


@dataclass(frozen=True, slots=True, kw_only=True)
class StereoConfig:
    """How depth is found in the photographs and fused.

    Attributes:
        image_side: Longer side of the photographs that are compared, pixels; the cost grows with
            its third power. 0 leaves stereo out.
        views: Most photographs that get a depth map.
        sources: Photographs that each is compared with.
        baseline_degrees: Angle at the object between a photograph and those it is compared with:
            less says little about depth, more changes what is seen.
        window: Half side of the windows that are compared, pixels.
        noise: Standard deviation of display values that no texture explains; windows with less
            contrast than that agree with nothing.
        penalties: What a step of one depth, and of more, between neighbouring pixels costs, in
            correlation.
        temperature: Difference of that cost that chance makes.
        least_agreeing: Other depth maps that must agree with a depth.
        least_correlation: Correlation that a depth must reach.
        tolerance: Difference of depth that counts as agreement, and the half width of the band in
            which distances are fused, cells of the fused lattice each.
        cells: Cells of that lattice along the object's longest side.
        least_trust: Sum of the maps' trust below which a distance counts as unknown.
        anchor: Weight of the visual hull's distance inside it, where that is unknown.
        smoothness: Weight of the squared Laplacian of the distances, against a trust of 1.
        fusion: Which maps speak for each other.
        smoothest: The solution for the smoothest distances.
        source_choice: Which photographs a photograph is compared with.
        surface: What distances and hull say together.
        sweep: The planes of a sweep.
    """

    image_side: int = 200
    views: int = 48
    sources: int = 4
    baseline_degrees: float = 14.0
    window: int = 3
    noise: float = 0.01
    penalties: tuple[float, float] = (0.06, 0.25)
    temperature: float = 0.05
    least_agreeing: int = 3
    least_correlation: float = 0.4
    tolerance: tuple[float, float] = (0.75, 4.0)
    cells: int = 128
    least_trust: float = 2.0
    anchor: float = 1e-5
    smoothness: float = 1.0
    fusion: FusionConfig = field(default_factory=FusionConfig)
    smoothest: SmoothestConfig = field(default_factory=SmoothestConfig)
    source_choice: SourceChoiceConfig = field(default_factory=SourceChoiceConfig)
    surface: SurfaceConfig = field(default_factory=SurfaceConfig)
    sweep: SweepConfig = field(default_factory=SweepConfig)

    def __post_init__(self) -> None:
        """Refuse values the step cannot work with."""
        for name, least in (("views", 3), ("sources", 2), ("window", 1), ("cells", 16)):
            if getattr(self, name) < least:
                raise ConfigError(
                    f"geometry.stereo.{name} is {getattr(self, name)}; it must be at least {least}"
                )
        for name in ("temperature", "anchor", "smoothness"):
            if not getattr(self, name) > 0:
                raise ConfigError(
                    f"geometry.stereo.{name} is {getattr(self, name)}; it must be above 0"
                )
        if self.image_side and self.image_side < 32:
            raise ConfigError(
                f"geometry.stereo.image_side is {self.image_side}; it must be 0 or at least 32"
            )
