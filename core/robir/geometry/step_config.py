# SPDX-License-Identifier: Apache-2.0
"""Settings of the steps that stand directly in this room."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated

from robir.settings import Within


@dataclass(frozen=True, slots=True, kw_only=True)
class MirrorMapConfig:
    """How what a surface mirrors is learnt from photographs.

    Attributes:
        side: Cells along each side of the map; 24 are 8 degrees wide in the middle, as fine as
            normals are known.
        grazing: Cosine of the view below which a normal a few degrees off mirrors quite another
            direction.
        held: Observations by which a cell is held to mirror nothing.
        rounds: Turns of solving spots and map after each other.
        least_views: Photographs that must show a spot from which the map is learnt.
    """

    side: Annotated[int, Within(2, 200)] = 24
    grazing: Annotated[float, Within(0, 1)] = 0.15
    held: Annotated[float, Within(0.01, 10_000)] = 20.0
    rounds: Annotated[int, Within(1, 1000)] = 12
    least_views: Annotated[int, Within(1, 1000)] = 3

    @property
    def cells(self) -> int:
        """Cells of the map; this number itself stands for a direction that says nothing."""
        return self.side * self.side


@dataclass(frozen=True, slots=True, kw_only=True)
class PredictionConfig:
    """How photographs predict each other over a surface.

    Attributes:
        judges: Photographs that are predicted; they lie far from each other.
        nearest: Photographs, the nearest to a judge, that predict it.
        whole: Coverage from which a pixel is object.
        outline: Distance from the outline within which masks are not believed.
        learnt_points: Points of the surface by which what is mirrored is learnt.
        slack: Distance by which a ray may end before the surface it is to see.
        mirror_map: What is mirrored.
    """

    judges: Annotated[int, Within(1, 1000)] = 12
    nearest: Annotated[int, Within(1, 20)] = 4
    whole: Annotated[float, Within(0, 0.999)] = 0.95
    outline: Annotated[int, Within(0, 100, "pixels")] = 2
    learnt_points: Annotated[int, Within(1, 10_000_000)] = 6000
    slack: Annotated[float, Within(0, 1, "unit frame")] = 0.01
    mirror_map: MirrorMapConfig = field(default_factory=MirrorMapConfig)


@dataclass(frozen=True, slots=True, kw_only=True)
class RivalConfig:
    """How the surfaces by stereo and by masks alone are set against the fit.

    Attributes:
        bent: Standard errors by which a surface must lead that bends e times as much: a fit full of
            pits bends 2 to 3.4 times as much as depth maps.
        smooth_rounds: Rounds of Taubin smoothing that take the steps of the cells out of an
            extracted surface.
        grain: Width of what may be noise of the refined surface.
        face_pixels: Pixels of a photograph a face: two faces a vertex, and a vertex every other row
            and column.
    """

    bent: Annotated[float, Within(0, 1000)] = 5.0
    smooth_rounds: Annotated[int, Within(0, 1000)] = 5
    grain: Annotated[float, Within(0.01, 100, "pixels")] = 1.5
    face_pixels: Annotated[float, Within(0.01, 10_000)] = 2.0


@dataclass(frozen=True, slots=True, kw_only=True)
class RemaskConfig:
    """How guessed masks are cut again by the surface that photographs show.

    Attributes:
        coarseness: Size of the photographs and of the lattice for these surfaces, as a share of the
            final ones.
        rounds: Surfaces and cuts, in turns.
    """

    coarseness: Annotated[float, Within(0.2, 1)] = 0.64
    rounds: Annotated[int, Within(0, 20)] = 2


@dataclass(frozen=True, slots=True, kw_only=True)
class HullConfig:
    """The visual hull.

    Attributes:
        clearance: Height above the table, unit frame, from which something belongs to the object,
            where masks were guessed.
    """

    clearance: Annotated[float, Within(0, 0.5)] = 0.015


@dataclass(frozen=True, slots=True, kw_only=True)
class RaySamplerConfig:
    """Which pixels the fit learns from.

    Attributes:
        ring: Width of the band around the mask whose pixels teach the field what is empty.
    """

    ring: Annotated[int, Within(1, 256, "pixels")] = 4
