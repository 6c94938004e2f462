# SPDX-License-Identifier: GPL-3.0-or-later
"""Draws one capture: a request and how it is photographed, both decided by a seed alone."""

import colorsys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from blender_scenes import textures
from blender_scenes.format import ToneMapping
from blender_scenes.population import ranges
from blender_scenes.recipe import Cameras, Ground, Paint, Part, Recipe, Rgb, SecondLight, Sky, Sun
from blender_scenes.request import SceneRequest
from blender_scenes.view_transform import FILMIC_LOOKS

_STREAMS = ("things", "paint", "ground", "light", "photographs", "cameras", "size")


@dataclass(frozen=True)
class Sources:
    """Files that things and light are drawn from.

    Attributes:
        assets: OBJ and glTF files; none leaves assets out.
        maps: lat-long maps, at least one.
    """

    assets: tuple[Path, ...]
    maps: tuple[Path, ...]


@dataclass(frozen=True)
class Drawn:
    """One capture of the population.

    Attributes:
        request: what is rendered.
        tone: how it is photographed; the exposure is what was drawn, before it is held to what
            may be clipped.
        thing: a key of `ranges.THINGS`.
        has_pattern: whether any of its things has one.
    """

    request: SceneRequest
    tone: ToneMapping
    thing: str
    has_pattern: bool

    @property
    def recipe(self) -> Recipe:
        """What was drawn of the scene."""
        if self.request.recipe is None:
            raise ValueError("a drawn capture has a recipe")
        return self.request.recipe


def draw(seed: int, sources: Sources) -> Drawn:
    """The capture of a seed.

    Args:
        seed: 0 or more. Each room draws from a stream of its own, so that a change of the table
            there leaves the others as they were.
        sources: files; another set of them makes other captures.
    """
    streams = {name: np.random.default_rng([seed, index]) for index, name in enumerate(_STREAMS)}
    thing, parts = _parts(streams["things"], streams["paint"], sources.assets)
    ground = _ground(streams["ground"], parts)
    light, file, sky = streams["light"], *_sky(streams["light"], sources.maps)
    second = SecondLight(_file(light, sources.maps), float(light.random()))
    resolution, views, samples = _size(streams["size"])
    cameras = _cameras(streams["cameras"])
    request = SceneRequest(
        scene="drawn",
        ground="none",
        light="lamp" if sky.suns else "hdri-sun",
        hdri=file,
        resolution=resolution,
        views=views,
        test_views=ranges.TEST_VIEWS,
        samples=samples,
        seed=seed,
        recipe=Recipe(parts, ground, sky, cameras, second),
    )
    has_pattern = any(part.paint.pattern != "plain" for part in parts)
    return Drawn(request, _tone(streams["photographs"]), thing, has_pattern)


def _choice(rng: np.random.Generator, weights: Mapping[str, float]) -> str:
    shares = np.array(list(weights.values()), dtype=float)
    return list(weights)[int(rng.choice(len(weights), p=shares / shares.sum()))]


def _file(rng: np.random.Generator, files: Sequence[Path]) -> Path:
    return files[int(rng.integers(len(files)))]


def _log(rng: np.random.Generator, bounds: tuple[float, float]) -> float:
    return float(np.exp(rng.uniform(*np.log(bounds))))


def _seed(rng: np.random.Generator) -> int:
    return int(rng.integers(1 << 31))


def _parts(
    rng: np.random.Generator, paint: np.random.Generator, assets: Sequence[Path]
) -> tuple[str, tuple[Part, ...]]:
    """What kind of scene it is, and its things."""
    weights = {k: w for k, w in ranges.THINGS.items() if k != "asset" or assets}
    thing = _choice(rng, weights)
    kinds = [thing]
    sizes = np.ones(1)
    if thing == "clutter":
        count = int(rng.integers(ranges.CLUTTER_COUNT[0], ranges.CLUTTER_COUNT[1] + 1))
        lone = {k: w for k, w in weights.items() if k != "clutter"}
        kinds = [_choice(rng, lone) for _ in range(count)]
        sizes = rng.uniform(*ranges.CLUTTER_SIZE, count)
    places = _places(rng, sizes)
    is_patterned, is_metal = paint.random(2) < (ranges.PATTERNED, ranges.METAL)
    metal = int(paint.integers(len(kinds))) if is_metal else -1
    parts = []
    for index, kind in enumerate(kinds):
        solid = _choice(rng, ranges.SOLIDS) if kind == "solid" else kind
        has_pattern = is_patterned and (index == 0 or paint.random() < ranges.PATTERNED_PART)
        is_tipped = kind != "asset" and rng.random() < ranges.TIPPED
        is_own = kind == "asset" and has_pattern and paint.random() < ranges.OWN_PAINT
        parts.append(
            Part(
                kind=solid,
                paint=_paint(
                    paint, has_pattern=has_pattern, is_metal=index == metal, is_own=is_own
                ),
                seed=_seed(rng),
                degrees=(90.0 * is_tipped, 0.0, float(rng.uniform(0.0, 360.0))),
                size=float(sizes[index]),
                place=places[index],
                file=_file(rng, assets) if kind == "asset" else None,
            )
        )
    return thing, tuple(parts)


def _places(rng: np.random.Generator, sizes: np.ndarray) -> list[tuple[float, float]]:
    """Middles of things, one after the other as near to the first as the gap allows."""
    places = [np.zeros(2)]
    for index in range(1, len(sizes)):
        turn = rng.uniform(0.0, 2.0 * np.pi)
        towards = np.array([np.cos(turn), np.sin(turn)])
        gaps = ranges.CLUTTER_GAP * (sizes[:index] + sizes[index])
        reach = 0.0
        # outwards along a ray until it is far enough from all that stand there
        while any(
            np.linalg.norm(reach * towards - p) < g for p, g in zip(places, gaps, strict=True)
        ):
            reach += 0.02
        places.append(reach * towards)
    return [(float(x), float(y)) for x, y in places - np.mean(places, axis=0)]


def _colour(rng: np.random.Generator, albedo_log: tuple[float, float]) -> Rgb:
    red, green, blue = colorsys.hsv_to_rgb(
        rng.random(), rng.uniform(*ranges.SATURATION), _log(rng, albedo_log)
    )
    low = ranges.ALBEDO_LOG[0]
    return max(red, low), max(green, low), max(blue, low)


def _colours(rng: np.random.Generator, albedo_log: tuple[float, float]) -> tuple[Rgb, Rgb]:
    """Two colours that can be told apart."""
    first = _colour(rng, albedo_log)
    while True:
        second = _colour(rng, albedo_log)
        if np.abs(np.log(first) - np.log(second)).max() >= np.log(ranges.CONTRAST):
            return first, second


def _paint(rng: np.random.Generator, *, has_pattern: bool, is_metal: bool, is_own: bool) -> Paint:
    pattern = _choice(rng, ranges.PATTERNS) if has_pattern else "plain"
    colours = _colours(rng, ranges.ALBEDO_LOG)
    roughness = rng.uniform(*(ranges.METAL_ROUGHNESS if is_metal else ranges.ROUGHNESS), 2)
    if is_metal:
        codes = rng.choice(ranges.METALS, 2, replace=False)
        colours = textures.linear_from_hex(codes[0]), textures.linear_from_hex(codes[1])
    if rng.random() > ranges.TWO_ROUGHNESSES:
        roughness[1] = roughness[0]
    return Paint(
        pattern="own" if is_own else pattern,
        colours=colours,
        roughness=(float(roughness[0]), float(roughness[1])),
        metallic=float(is_metal),
        cells=round(_log(rng, ranges.CELLS_LOG)),
    )


def _ground(rng: np.random.Generator, parts: Sequence[Part]) -> Ground | None:
    if rng.random() >= ranges.GROUND:
        return None
    shape, pattern = _choice(rng, ranges.GROUND_SHAPES), _choice(rng, ranges.GROUND_PATTERNS)
    reach = max(float(np.hypot(*part.place)) + 0.6 * part.size for part in parts)
    roughness = float(rng.uniform(*ranges.GROUND_ROUGHNESS))
    paint = Paint(
        pattern=pattern,
        colours=_colours(rng, ranges.GROUND_ALBEDO_LOG),
        roughness=(roughness, roughness),
        metallic=0.0,
        cells=int(rng.integers(ranges.GROUND_CELLS[0], ranges.GROUND_CELLS[1] + 1)),
    )
    return Ground(shape, paint, reach * float(rng.uniform(*ranges.GROUND_SIZE[shape])), _seed(rng))


def _sky(rng: np.random.Generator, maps: Sequence[Path]) -> tuple[Path, Sky]:
    kind, file = _choice(rng, ranges.SUNS), _file(rng, maps)
    share = float(rng.uniform(*ranges.SUN_SHARE))
    shares = [share, share * float(rng.uniform(*ranges.SECOND_SUN))]
    count = {"one sun": 1, "two suns": 2}.get(kind, 0)
    suns = [
        Sun(
            elevation=float(rng.uniform(*ranges.SUN_ELEVATION)),
            azimuth=float(rng.uniform(0.0, 360.0)),
            size=_log(rng, ranges.SUN_SIZE_LOG),
            share=each,
        )
        for each in shares[:count]
    ]
    turn = float(rng.random())
    return file, Sky(turn, tuple(suns), is_softened=kind != "the map alone")


def _tone(rng: np.random.Generator) -> ToneMapping:
    name, look = _choice(rng, ranges.TONES), str(rng.choice(FILMIC_LOOKS))
    backdrop = _choice(rng, ranges.BACKDROPS)
    has_look = name == "Filmic with a look"
    return ToneMapping(
        view_transform="Filmic" if has_look else name,
        exposure=float(rng.uniform(*ranges.EXPOSURE)),
        look=look if has_look else None,
        backdrop=None if backdrop == "none" else backdrop,
    )


def _cameras(rng: np.random.Generator) -> Cameras:
    kind = _choice(rng, ranges.CAMERAS)
    low, high = float(rng.uniform(*ranges.DOME_LOW)), float(rng.uniform(*ranges.DOME_HIGH))
    middle = float(rng.uniform(*ranges.RING_ELEVATION))
    half = 0.5 * ranges.RING_WIDTH
    width = float(rng.uniform(*ranges.HALF_DOME_WIDTH)) if kind == "half dome" else 360.0
    return Cameras(
        kind=kind,
        elevation=(middle - half, middle + half) if kind == "ring" else (low, high),
        azimuth=(float(rng.uniform(0.0, 360.0)), width),
        margin=float(rng.uniform(*ranges.MARGIN)),
    )


def _size(rng: np.random.Generator) -> tuple[int, int, int]:
    """Resolution, training views and samples, together within what a capture may cost."""
    resolution = round(_log(rng, ranges.RESOLUTION_LOG))
    pixels = resolution**2
    most = int(ranges.PIXEL_SAMPLES / ranges.LEAST_SAMPLES / pixels) - 2 * ranges.TEST_VIEWS
    low, high = ranges.VIEWS_LOG
    views = round(_log(rng, (low, max(min(high, most), low))))
    samples = ranges.PIXEL_SAMPLES / pixels / (views + 2 * ranges.TEST_VIEWS)
    return resolution, views, int(np.clip(samples, ranges.LEAST_SAMPLES, ranges.MOST_SAMPLES))
