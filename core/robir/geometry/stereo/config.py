# SPDX-License-Identifier: Apache-2.0
"""Settings of the depth maps and of their fusion."""

from __future__ import annotations

from dataclasses import dataclass

from robir.errors import ConfigError


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
