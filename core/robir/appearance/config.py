# SPDX-License-Identifier: Apache-2.0
"""Settings of the appearance stage."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from robir.errors import ConfigError

FAMILIES = ("standard", "camera", "filmic", "khronos_pbr_neutral", "agx", "robir_aces")
"""Candidates, simplest first."""


@dataclass(frozen=True, slots=True, kw_only=True)
class AppearanceConfig:
    """How the light is searched and how the textures are made.

    Attributes:
        families: Tone curves that may be chosen; one alone is taken as given.
        origin: Where the photographs are from: "camera" or "render". It weighs in the choice of the
            tone curve; "auto" takes the first for the likelier.
        num_soft_lobes: Fixed soft lobes that stand for the sky.
        num_sharp_lobes: Sharp lobes (suns, lamps) that may be found at most.
        num_scan_directions: Directions of the whole sphere scanned for suns.
        num_solve_surfels: Surface samples by which suns and the tone curve are found; strengths and
            specular material are found by all that two photographs show.
        iterations: Adam steps of the last light solve; trial solves take a third.
        num_materials: Patches of like albedo and place that share one roughness.
        shading_size: Side of the square atlas on which light and albedo are separated, texels.
        texture_size: Largest side of the textures, texels, a multiple of `shading_size` by a power
            of two; as fine as photographs resolve. Of UDIM tiles it is that of each, up to 8192
            squared together.
        white_point: A spot of known albedo: u and v on the texture, v upwards, then linear Rec.709;
            empty if none. It fixes brightness and hue of light and albedo.
        sun: Direction towards the sun, capture frame, if the user knows it, else empty.
        without: Names of steps that are left out, to see what they are worth.
    """

    families: tuple[str, ...] = FAMILIES
    origin: Literal["auto", "camera", "render"] = "auto"
    num_soft_lobes: int = 64
    num_sharp_lobes: int = 2
    num_scan_directions: int = 2000
    num_solve_surfels: int = 5000
    iterations: int = 240
    num_materials: int = 40
    shading_size: int = 512
    texture_size: int = 2048
    white_point: tuple[float, ...] = ()
    sun: tuple[float, ...] = ()
    without: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Refuse unknown families and sizes that cannot work."""
        unknown = sorted(set(self.families) - set(FAMILIES))
        if unknown or not self.families:
            raise ConfigError(
                f"appearance.families is {list(self.families)}; it must name some of "
                f"{', '.join(FAMILIES)}"
            )
        for name, low in (
            ("num_soft_lobes", 4),
            ("num_sharp_lobes", 0),
            ("num_scan_directions", 200),
            ("num_solve_surfels", 500),
            ("iterations", 20),
            ("num_materials", 1),
            ("shading_size", 32),
            ("texture_size", 32),
        ):
            if getattr(self, name) < low:
                raise ConfigError(
                    f"appearance.{name} is {getattr(self, name)}; it must be at least {low}"
                )
        if self.white_point and not _is_white_point(self.white_point):
            raise ConfigError(
                f"appearance.white_point is {list(self.white_point)}; it must be u and v of a "
                "texel, not negative, and its albedo red, green and blue, above 0 and at most 1"
            )
        if self.sun and (len(self.sun) != 3 or not any(self.sun) or self.num_sharp_lobes < 1):
            raise ConfigError(
                f"appearance.sun is {list(self.sun)}; it must be a direction x, y, z towards the "
                "sun, and appearance.num_sharp_lobes at least 1"
            )


def _is_white_point(values: tuple[float, ...]) -> bool:
    """Whether these are a texel and an albedo."""
    texel, albedo = values[:2], values[2:]
    return len(albedo) == 3 and min(texel) >= 0 and all(0 < value <= 1 for value in albedo)
