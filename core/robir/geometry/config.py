# SPDX-License-Identifier: Apache-2.0
"""Settings of the geometry stage."""

from __future__ import annotations

from dataclasses import dataclass

from robir.errors import ConfigError


@dataclass(frozen=True, slots=True, kw_only=True)
class GeometryConfig:
    """How fine the surface and its mesh become.

    Attributes:
        image_side: Longer side the photographs are reduced to for the fit, pixels.
        hull_cells: Cells of the visual hull along the longest side of the object.
        level_cells: Cells of the distance field along the object's longest side, coarse to fine.
        level_steps: Steps of the fit at each of these levels.
        rays: Rays of a step.
        stereo_side: Longer side of the photographs that depth maps are made of, pixels; the cost
            grows with its third power. 0 leaves depth maps out.
        refine_sides: Longer side of the photographs at each level of the refinement, pixels.
        face_budget: Most triangles of the final mesh.
        quads: Whether faces are quads of about one size instead of triangles that follow the shape.
            Each is two triangles, which Blender joins (Tris to Quads); needs pyinstantmeshes.
        unwrap_seconds: Longest processor time an unwrapping attempt may take, seconds.
        fit_mesh: Whether a mesh that the user hands in is turned, scaled and shifted to where the
            photographs show it.
        without: Names of steps that are left out, to see what they are worth.
    """

    image_side: int = 200
    hull_cells: int = 96
    level_cells: tuple[int, ...] = (64, 96, 128)
    level_steps: tuple[int, ...] = (280, 220, 220)
    rays: int = 2048
    stereo_side: int = 200
    refine_sides: tuple[int, ...] = (400, 800)
    face_budget: int = 8000
    quads: bool = False
    unwrap_seconds: float = 40.0
    fit_mesh: bool = False
    without: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Refuse values the stage cannot work with."""
        if not self.level_cells or len(self.level_cells) != len(self.level_steps):
            raise ConfigError(
                f"geometry.level_cells has {len(self.level_cells)} entries and "
                f"geometry.level_steps {len(self.level_steps)}; give one number of steps a level"
            )
        lowest = {
            "image_side": 32,
            "hull_cells": 16,
            "rays": 64,
            "face_budget": 100,
            "unwrap_seconds": 0.0,
        }
        for name, least in lowest.items():
            if getattr(self, name) < least:
                raise ConfigError(
                    f"geometry.{name} is {getattr(self, name)}; it must be at least {least}"
                )
        if min(self.level_cells) < 16 or min(self.level_steps) < 1:
            raise ConfigError("geometry.level_cells must be at least 16 and level_steps at least 1")
        if self.stereo_side and self.stereo_side < 32:
            raise ConfigError(
                f"geometry.stereo_side is {self.stereo_side}; it must be 0 or at least 32"
            )
        if not self.refine_sides:
            raise ConfigError("geometry.refine_sides is empty; give one size at least")
