# SPDX-License-Identifier: GPL-3.0-or-later
"""A scene written down: what stands where, how it is painted and lit, and who looks at it."""

from dataclasses import dataclass
from pathlib import Path

Rgb = tuple[float, float, float]

PATTERNS = (
    "plain", "checker", "stripes", "speckled", "clouds", "wood", "noise", "cells", "waves", "own",
)  # fmt: skip
"""One colour; image textures made with numpy; procedural textures of Blender's; an asset's own."""

PROCEDURAL = ("noise", "cells", "waves")

KINDS = (
    "asset", "monkey", "box", "cylinder", "cone", "sphere", "tube", "lathe", "boolean",
)  # fmt: skip
GROUND_SHAPES = ("disc", "mat", "table")
CAMERA_KINDS = ("dome", "ring", "half dome", "handheld")


@dataclass(frozen=True)
class Paint:
    """The material of one thing.

    Attributes:
        pattern: one of PATTERNS.
        colours: two base colours, linear Rec.709, 0.02..0.9; a plain paint has the first alone.
        roughness: of the Principled shader where each colour is, 0.05..1.
        metallic: 0 or 1.
        cells: how often the pattern repeats along the thing.
    """

    pattern: str
    colours: tuple[Rgb, Rgb]
    roughness: tuple[float, float]
    metallic: float
    cells: int


@dataclass(frozen=True)
class Part:
    """One thing of a scene.

    Attributes:
        kind: one of KINDS.
        paint: its material.
        seed: decides its shape and texture beyond what is said here.
        degrees: Euler angles that it is turned by, before it is set on the ground.
        size: longest side of its bounding box, scene units.
        place: x and y of the middle of its bounding box.
        file: OBJ or glTF file of an asset, else None.
    """

    kind: str
    paint: Paint
    seed: int
    degrees: tuple[float, float, float]
    size: float
    place: tuple[float, float]
    file: Path | None = None


@dataclass(frozen=True)
class Ground:
    """What the things stand on, its upper side at z = 0.

    Attributes:
        shape: one of GROUND_SHAPES: a thick round plate, a thin round mat, a square table top.
        paint: its material.
        size: radius, or half of the table's side, scene units.
        seed: decides its texture.
    """

    shape: str
    paint: Paint
    size: float
    seed: int


@dataclass(frozen=True)
class Sun:
    """A distant lamp beside a map.

    Attributes:
        elevation: degrees above the horizon.
        azimuth: degrees from +x towards +y.
        size: full angle of its disc in degrees.
        share: of the lamp in the irradiance of a surface that faces it, without other lamps.
    """

    elevation: float
    azimuth: float
    size: float
    share: float


@dataclass(frozen=True)
class Sky:
    """A map and the lamps beside it.

    Attributes:
        turn: by which the map is turned about z, share of a whole turn.
        suns: none to two, the strongest first.
        is_softened: whether the map's own bright spots are dimmed, so that the lamps, or nothing,
            are the sun.
    """

    turn: float
    suns: tuple[Sun, ...]
    is_softened: bool


@dataclass(frozen=True)
class Cameras:
    """Where the photographs are taken from; distances follow from the size of the scene.

    Attributes:
        kind: one of CAMERA_KINDS.
        elevation: lowest and highest, degrees.
        azimuth: start and width of the range of directions, degrees.
        margin: distance over the one at which the scene's bounding sphere fills the picture.
    """

    kind: str
    elevation: tuple[float, float]
    azimuth: tuple[float, float]
    margin: float


@dataclass(frozen=True)
class SecondLight:
    """Another light under which the test views are rendered too.

    Attributes:
        file: lat-long map.
        turn: share of a whole turn about z.
    """

    file: Path
    turn: float


@dataclass(frozen=True)
class Recipe:
    """A whole scene but for the map, which the request names."""

    parts: tuple[Part, ...]
    ground: Ground | None
    sky: Sky
    cameras: Cameras
    second_light: SecondLight
