# SPDX-License-Identifier: GPL-3.0-or-later
"""A capture of photographs written down: what stands where, in which light, how it is taken."""

from dataclasses import dataclass
from pathlib import Path

from blender_scenes.recipe import Rgb, SecondLight

THINGS = (
    "asset", "box", "bottle", "tin", "mug", "bowl", "vase", "egg", "cushion", "toy", "carving",
    "tool", "figure",
)  # fmt: skip
PATTERNS = (
    "plain", "label", "stripes", "checker", "speckled", "clouds", "wood", "weave", "stone", "own",
)  # fmt: skip
BUMPS = ("none", "weave", "grain", "clay")
LIGHTS = ("window", "lamp", "sun", "overcast")
LAYOUTS = ("transforms.json", "colmap", "photographs")
POSES = ("exact", "errors", "none")
MASKS = ("given", "off", "none")


@dataclass(frozen=True)
class Finish:
    """A material.

    Attributes:
        pattern: one of PATTERNS.
        colours: two or three base colours, linear Rec.709, 0.02..0.9.
        roughness: of the Principled shader.
        metallic: 0 or 1.
        cells: how often the pattern repeats.
        coat: weight of a clear coat, 0..1.
        sheen: weight of sheen, 0..1.
        bump: one of BUMPS.
        seed: decides the texture beyond what is said here.
    """

    pattern: str
    colours: tuple[Rgb, ...]
    roughness: float
    metallic: float = 0.0
    cells: int = 4
    coat: float = 0.0
    sheen: float = 0.0
    bump: str = "none"
    seed: int = 0


@dataclass(frozen=True)
class Thing:
    """What is photographed; its longest side is 1 scene unit.

    Attributes:
        kind: one of THINGS.
        body: its main material.
        trim: material of caps, handles, rims and screws.
        seed: decides its shape.
        turn: degrees about z.
        file: OBJ or glTF file of an asset, else None.
    """

    kind: str
    body: Finish
    trim: Finish
    seed: int
    turn: float
    file: Path | None = None


@dataclass(frozen=True)
class Table:
    """What it stands on, its upper side at z = 0.

    Attributes:
        shape: "square" or "round".
        finish: its material.
        size: half of its side, or radius, scene units.
        turn: degrees about z.
    """

    shape: str
    finish: Finish
    size: float
    turn: float


@dataclass(frozen=True)
class Light:
    """What shines.

    Attributes:
        kind: one of LIGHTS; a window or a lamp stands in a room, the others beside a map.
        file: lat-long map; of a room, what it is not used for.
        turn: of the map about z, share of a whole turn.
        azimuth: of window, lamp or sun, degrees.
        elevation: of lamp or sun, degrees.
        size: of the window (width), the lamp (radius), scene units, or the sun, degrees.
        share: of the sun in the irradiance of a surface that faces it.
        tint: of window or lamp, linear, its largest channel 1.
        wall: of the room.
    """

    kind: str
    file: Path
    turn: float
    azimuth: float
    elevation: float
    size: float
    share: float
    tint: Rgb
    wall: Finish


@dataclass(frozen=True)
class Arc:
    """One walk round the thing.

    Attributes:
        photographs: how many.
        elevation: degrees.
        start: azimuth of its first photograph, degrees.
        width: degrees walked.
    """

    photographs: int
    elevation: float
    start: float
    width: float


@dataclass(frozen=True)
class Walk:
    """Where the photographs are taken from.

    Attributes:
        arcs: one after the other.
        fill: of the thing's diameter in the shorter side of a photograph, about.
        seed: of the hand that holds the camera.
    """

    arcs: tuple[Arc, ...]
    fill: float
    seed: int

    @property
    def photographs(self) -> int:
        """How many there are."""
        return sum(arc.photographs for arc in self.arcs)


@dataclass(frozen=True)
class Frame:
    """Size of the photographs.

    Attributes:
        width: in pixels.
        height: in pixels.
        angle: full angle of the longer side, degrees.
    """

    width: int
    height: int
    angle: float

    @property
    def focal(self) -> float:
        """Focal length in pixels; the principal point is the middle."""
        from math import radians, tan

        return 0.5 * max(self.width, self.height) / tan(0.5 * radians(self.angle))


@dataclass(frozen=True)
class Developing:
    """What becomes of radiance in a camera.

    Attributes:
        response: the three numbers of `response.response`.
        iso: speed, decides the noise.
        full_well: electrons of a pixel at ISO 100 that make white.
        read_noise: electrons, standard deviation.
        quality: of the JPEG file.
        brightness: stops by which the picture is brighter than metered.
        exposure_jitter: the most that a photograph departs from that, stops.
        white_balance: (3,) factors by which the camera's white is off.
        balance_jitter: spread of the same between photographs.
        vignetting: 0 none, 1 cos^4 of the field angle.
        has_exif: whether the files say how they were taken.
        seed: of noise and jitter.
    """

    response: tuple[float, float, float]
    iso: float
    full_well: float
    read_noise: float
    quality: int
    brightness: float
    exposure_jitter: float
    white_balance: Rgb
    balance_jitter: float
    vignetting: float
    has_exif: bool
    seed: int


@dataclass(frozen=True)
class Errors:
    """Errors of poses, as structure from motion makes them; see `posing`.

    Attributes:
        focal: relative, one for all photographs.
        aim: standard deviation of where a photograph shows the thing, pixels at 1000 pixels.
        orbit: of the camera's place about the thing, degrees.
        distance: of its distance, relative.
        roll: about the view axis, degrees.
    """

    focal: float
    aim: float
    orbit: float
    distance: float
    roll: float


@dataclass(frozen=True)
class Handover:
    """What the user brings.

    Attributes:
        layout: one of LAYOUTS.
        poses: one of POSES.
        errors: of the poses where they have some.
        masks: one of MASKS.
        growth: pixels by which masks are too large, below 0 too small, where they are off.
        seed: of errors.
    """

    layout: str
    poses: str
    errors: Errors
    masks: str
    growth: float
    seed: int


@dataclass(frozen=True)
class PhotoRecipe:
    """A whole capture of photographs.

    Attributes:
        seed: of the capture.
        samples: Cycles samples of a pixel.
    """

    seed: int
    thing: Thing
    table: Table
    light: Light
    second_light: SecondLight
    walk: Walk
    frame: Frame
    developing: Developing
    handover: Handover
    samples: int
