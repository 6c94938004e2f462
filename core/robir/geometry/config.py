# SPDX-License-Identifier: Apache-2.0
"""Settings of the geometry stage; the defaults are those of the preset `draft`."""

from __future__ import annotations

from dataclasses import dataclass, field

from robir.errors import ConfigError
from robir.geometry.fit.config import FitConfig
from robir.geometry.given.config import GivenConfig
from robir.geometry.ground.config import GroundConfig
from robir.geometry.mesh.config import MeshConfig
from robir.geometry.refine.config import RefineConfig
from robir.geometry.step_config import (
    HullConfig,
    PredictionConfig,
    RaySamplerConfig,
    RemaskConfig,
    RivalConfig,
)
from robir.geometry.stereo.config import StereoConfig


@dataclass(frozen=True, slots=True, kw_only=True)
class GeometryConfig:
    """How the surface is found and how fine the mesh becomes.

    Attributes:
        image_side: Longer side the photographs are reduced to for the fit, pixels.
        hull_cells: Cells of the visual hull along the longest side of the object.
        hull_views: Most views the visual hull is carved with, and the ground is told by.
        level_cells: Cells of the distance field along the object's longest side, coarse to fine.
        level_steps: Steps of the fit at each of these levels.
        rays: Rays of a step.
        features: Colour features of a node of the field.
        face_budget: Most triangles of the final mesh.
        unwrap_seconds: Longest processor time an unwrapping attempt may take, seconds.
        refine_poses: Whether given cameras are turned where the photographs ask for it.
        fit_mesh: Whether a mesh that the user hands in is turned, scaled and shifted to where the
            photographs show it.
        hull: The visual hull.
        ray_sampler: Which pixels the fit learns from.
        fit: The fit of field and colours, by its parts.
        given: A mesh that the user hands in.
        ground: What the object stands on.
        remask: Cutting of guessed masks anew.
        prediction: By which surfaces are judged.
        rival: How the fit is set against other surfaces.
        mesh: From a dense surface to the mesh that carries a texture.
        stereo: Depth maps, whose surface takes the place of the fit where it is better.
        refine: That surface's way to where photographs agree.
        without: Names of steps that are left out, to see what they are worth.
    """

    image_side: int = 200
    hull_cells: int = 96
    hull_views: int = 48
    level_cells: tuple[int, ...] = (64, 96, 128)
    level_steps: tuple[int, ...] = (280, 220, 220)
    rays: int = 2048
    features: int = 8
    face_budget: int = 8000
    unwrap_seconds: float = 40.0
    refine_poses: bool = True
    fit_mesh: bool = False
    hull: HullConfig = field(default_factory=HullConfig)
    ray_sampler: RaySamplerConfig = field(default_factory=RaySamplerConfig)
    fit: FitConfig = field(default_factory=FitConfig)
    given: GivenConfig = field(default_factory=GivenConfig)
    ground: GroundConfig = field(default_factory=GroundConfig)
    remask: RemaskConfig = field(default_factory=RemaskConfig)
    prediction: PredictionConfig = field(default_factory=PredictionConfig)
    rival: RivalConfig = field(default_factory=RivalConfig)
    mesh: MeshConfig = field(default_factory=MeshConfig)
    stereo: StereoConfig = field(default_factory=StereoConfig)
    refine: RefineConfig = field(default_factory=RefineConfig)
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
            "hull_views": 3,
            "rays": 64,
            "features": 4,
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
