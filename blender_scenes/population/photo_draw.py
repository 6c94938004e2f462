# SPDX-License-Identifier: GPL-3.0-or-later
"""Draws one capture of photographs, by a seed alone."""

import colorsys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from blender_scenes import textures
from blender_scenes.photographs.recipe import (
    Arc,
    Developing,
    Errors,
    Finish,
    Frame,
    Handover,
    Light,
    PhotoRecipe,
    Table,
    Thing,
    Walk,
)  # fmt: skip
from blender_scenes.photographs.response import drawn_response
from blender_scenes.population import photo_ranges as table
from blender_scenes.population import ranges
from blender_scenes.population.draw import Sources
from blender_scenes.recipe import Rgb, SecondLight

_STREAMS = ("thing", "table", "light", "camera", "developing", "handover", "size")
_PHOTOGRAPHS = 1
"""Sets these streams apart from those of the other half."""

_RATIOS = {"4:3": (4, 3), "3:4": (3, 4), "3:2": (3, 2), "2:3": (2, 3), "1:1": (1, 1)}


def draw_photographs(seed: int, sources: Sources) -> PhotoRecipe:
    """The capture of a seed.

    Args:
        seed: 0 or more.
        sources: files; another set of them makes other captures.
    """
    streams = {
        name: np.random.default_rng([seed, index, _PHOTOGRAPHS])
        for index, name in enumerate(_STREAMS)
    }
    frame, photographs, samples = _size(streams["size"])
    light = streams["light"]
    return PhotoRecipe(
        seed=seed,
        thing=_thing(streams["thing"], sources.assets, table.SHOWCASES.get(seed)),
        table=_table(streams["table"]),
        light=_light(light, sources.maps, table.SHOWCASE_LIGHTS.get(seed)),
        second_light=SecondLight(_file(light, sources.maps), float(light.random())),
        walk=_walk(streams["camera"], photographs),
        frame=frame,
        developing=_developing(streams["developing"]),
        handover=_handover(streams["handover"]),
        samples=samples,
    )


def _choice(rng: np.random.Generator, weights: Mapping[str, float]) -> str:
    shares = np.array(list(weights.values()), dtype=float)
    return list(weights)[int(rng.choice(len(weights), p=shares / shares.sum()))]


def _file(rng: np.random.Generator, files: Sequence[Path]) -> Path:
    return files[int(rng.integers(len(files)))]


def _log(rng: np.random.Generator, bounds: tuple[float, float]) -> float:
    return float(np.exp(rng.uniform(*np.log(bounds))))


def _even(rng: np.random.Generator, bounds: tuple[float, float]) -> float:
    return float(rng.uniform(*bounds))


def _seed(rng: np.random.Generator) -> int:
    return int(rng.integers(1 << 31))


def _colour(
    rng: np.random.Generator, albedo_log: tuple[float, float], saturation: tuple[float, float]
) -> Rgb:
    red, green, blue = colorsys.hsv_to_rgb(
        rng.random(), rng.uniform(*saturation), _log(rng, albedo_log)
    )
    low = ranges.ALBEDO_LOG[0]
    return max(red, low), max(green, low), max(blue, low)


def _colours(
    rng: np.random.Generator,
    albedo_log: tuple[float, float],
    count: int,
    contrast: float,
    saturation: tuple[float, float] = table.SATURATION,
) -> tuple[Rgb, ...]:
    """Colours of which each can be told from the one before."""
    colours = [_colour(rng, albedo_log, saturation)]
    while len(colours) < count:
        new = _colour(rng, albedo_log, saturation)
        if np.abs(np.log(new) - np.log(colours[-1])).max() >= np.log(contrast):
            colours.append(new)
    return tuple(colours)


def _tones(rng: np.random.Generator, albedo_log: tuple[float, float]) -> tuple[Rgb, Rgb]:
    """A colour and a darker tone of it, as wood, clay and stone have."""
    light = _colour(rng, albedo_log, (0.1, 0.6))
    share = rng.uniform(0.3, 0.65, 3)
    red, green, blue = (max(c * s, 0.02) for c, s in zip(light, np.sort(share)[::-1], strict=True))
    return (float(red), float(green), float(blue)), light


def _body(rng: np.random.Generator, kind: str) -> Finish:
    """What a thing is of, by one of the names in `table.MATERIALS`."""
    colours = _colours(rng, table.ALBEDO_LOG, 3, ranges.CONTRAST)
    tones, cells = _tones(rng, (0.15, 0.7)), int(rng.integers(table.CELLS[0], table.CELLS[1] + 1))
    gloss, matte = _even(rng, table.GLOSS), _even(rng, table.MATTE)
    coat = _even(rng, table.COAT)
    has_coat, seed = rng.random() < table.COATED, _seed(rng)
    paper = _colour(rng, (0.45, 0.85), (0.0, 0.35)), *_colours(rng, (0.04, 0.4), 2, 1.5)
    if kind == "print":
        roughness = gloss if rng.random() < 0.5 else matte
        return Finish("label", paper, roughness, cells=cells, coat=coat * has_coat, seed=seed)
    if kind == "card":
        return Finish("plain", colours, matte, seed=seed)
    if kind == "plastic":
        pattern = "plain" if rng.random() < 0.6 else "stripes"
        return Finish(pattern, colours, gloss, cells=cells, seed=seed)
    if kind in ("glaze", "spotted glaze", "printed glaze"):
        pattern = {"glaze": "plain", "spotted glaze": "speckled"}.get(kind, "label")
        inks = paper if kind == "printed glaze" else colours
        return Finish(pattern, inks, matte, cells=cells, coat=coat, seed=seed)
    if kind == "car paint":
        return Finish("plain", colours, matte, coat=coat, seed=seed)
    if kind == "paint":
        return Finish("stripes", colours, gloss, cells=cells, coat=coat * has_coat, seed=seed)
    if kind == "wood":
        return Finish("wood", tones, matte, cells=2, coat=0.6 * coat * has_coat, bump="grain",
                      seed=seed)  # fmt: skip
    if kind == "clay":
        pattern = "clouds" if rng.random() < 0.5 else "plain"
        return Finish(pattern, tones, matte, cells=cells, bump="clay", seed=seed)
    if kind == "cloth":
        return Finish("weave", colours[:2], 0.9, cells=2, sheen=_even(rng, table.SHEEN),
                      bump="weave", seed=seed)  # fmt: skip
    if kind == "shell":
        shell = _colour(rng, table.SHELL_ALBEDO_LOG, (0.0, 0.6))
        return Finish("plain", (shell, shell), matte, seed=seed)
    return Finish("own", colours, matte, seed=seed)


def _thing(rng: np.random.Generator, assets: Sequence[Path], asked: str | None) -> Thing:
    weights = {k: w for k, w in table.THINGS.items() if k != "asset" or assets}
    drawn = _choice(rng, weights)
    kind = asked or drawn
    body = _body(rng, _choice(rng, table.MATERIALS[kind]))
    if asked == "vase":  # as dark as it takes for its inside to be black
        body = replace(body, colours=table.DARK_TONES, coat=0.0)
    is_metal = rng.random() < table.METAL_TRIM.get(kind, 0.0)
    code, roughness = str(rng.choice(ranges.METALS)), _even(rng, table.METAL_ROUGHNESS)
    plastic = _colours(rng, table.ALBEDO_LOG, 2, ranges.CONTRAST)
    if is_metal:
        metal = textures.linear_from_hex(code)
        trim = Finish("plain", (metal, metal), roughness, metallic=1.0)
    else:
        trim = Finish("plain", plastic, _even(rng, table.GLOSS))
    file = _file(rng, assets) if kind == "asset" else None
    return Thing(kind, body, trim, _seed(rng), _even(rng, (0.0, 360.0)), file)


def _table(rng: np.random.Generator) -> Table:
    pattern, shape = _choice(rng, table.TABLES), str(rng.choice(("square", "round")))
    toned = _tones(rng, (0.2, 0.75))
    while True:
        colours = _colours(
            rng, table.TABLE_ALBEDO_LOG, 3, table.TABLE_CONTRAST, table.TABLE_SATURATION
        )
        if pattern != "label" or max(colours[0]) > 0.3:
            break
    is_toned = pattern in ("wood", "stone")
    finish = Finish(
        pattern=pattern,
        colours=toned if is_toned else colours,
        roughness=_even(rng, table.TABLE_ROUGHNESS),
        cells=int(rng.integers(table.CELLS[0], table.CELLS[1] + 1)),
        seed=_seed(rng),
    )
    return Table(shape, finish, _even(rng, table.TABLE_SIZE), _even(rng, (0.0, 90.0)))


def _light(rng: np.random.Generator, maps: Sequence[Path], asked: str | None) -> Light:
    drawn = _choice(rng, table.LIGHTS)
    kind = asked or drawn
    fit = [file for file in maps if file.stem not in table.UNFIT_MAPS]
    warmth = _even(rng, table.LAMP_TINT if kind == "lamp" else table.WINDOW_TINT)
    tint = np.array([warmth**0.5, 1.0, warmth**-0.5])
    red, green, blue = (float(c) for c in tint / tint.max())
    sizes = {
        "window": _even(rng, table.WINDOW_WIDTH),
        "lamp": _log(rng, table.LAMP_RADIUS_LOG),
        "sun": _log(rng, table.SUN_SIZE_LOG),
        "overcast": 0.0,
    }
    is_lamp = kind == "lamp"
    wall = _colour(rng, table.WALL_ALBEDO_LOG, table.WALL_SATURATION)
    darker = (0.7 * wall[0], 0.7 * wall[1], 0.7 * wall[2])
    pattern = str(rng.choice(("stripes", "clouds", "speckled")))
    return Light(
        kind=kind,
        file=_file(rng, fit or maps),
        turn=float(rng.random()),
        azimuth=_even(rng, (0.0, 360.0)),
        elevation=_even(rng, table.LAMP_ELEVATION if is_lamp else table.SUN_ELEVATION),
        size=sizes[kind],
        share=_even(rng, table.SUN_SHARE),
        tint=(red, green, blue),
        wall=Finish(
            pattern=pattern if rng.random() < table.PATTERNED_WALL else "plain",
            colours=(wall, darker),
            roughness=0.9,
            cells=6,
            seed=_seed(rng),
        ),
    )


def _walk(rng: np.random.Generator, photographs: int) -> Walk:
    low = round(photographs * _even(rng, table.LOW_SHARE))
    arcs = []
    for count, elevations in ((low, table.LOW), (photographs - low, table.HIGH)):
        width = _even(rng, table.WALKED) if rng.random() < table.GAPS else 360.0
        arcs.append(Arc(count, _even(rng, elevations), _even(rng, (0.0, 360.0)), width))
    return Walk(tuple(arcs), _even(rng, table.FILL), _seed(rng))


def _developing(rng: np.random.Generator) -> Developing:
    red, green, blue = 1.0 + rng.uniform(-1.0, 1.0, 3) * table.WHITE_BALANCE
    is_jittered, is_vignetted = rng.random(2) < (table.JITTERED, table.VIGNETTED)
    return Developing(
        response=drawn_response(rng, table.RESPONSE_SPREAD),
        iso=_log(rng, table.ISO_LOG),
        full_well=_log(rng, table.FULL_WELL_LOG),
        read_noise=_even(rng, table.READ_NOISE),
        quality=int(rng.integers(table.QUALITY[0], table.QUALITY[1] + 1)),
        brightness=_even(rng, table.BRIGHTNESS),
        exposure_jitter=_even(rng, table.EXPOSURE_JITTER) * is_jittered,
        white_balance=(float(red), float(green), float(blue)),
        balance_jitter=_even(rng, table.BALANCE_JITTER),
        vignetting=_even(rng, table.VIGNETTING) * is_vignetted,
        has_exif=bool(rng.random() < table.EXIF),
        seed=_seed(rng),
    )


def _handover(rng: np.random.Generator) -> Handover:
    poses, masks = _choice(rng, table.POSES), _choice(rng, table.MASKS)
    layout = _choice(rng, table.POSED_LAYOUTS)
    errors = Errors(
        focal=float(np.clip(rng.normal(), -2.0, 2.0)) * table.FOCAL_ERROR,
        aim=_even(rng, table.AIM_ERROR),
        orbit=_even(rng, table.ORBIT_ERROR),
        distance=_even(rng, table.DISTANCE_ERROR),
        roll=_even(rng, table.ROLL_ERROR),
    )
    growth = _even(rng, table.GROWTH) * float(rng.choice((-1.0, 1.0)))
    return Handover(
        layout="photographs" if poses == "none" else layout,
        poses=poses,
        errors=errors,
        masks=masks,
        growth=growth,
        seed=_seed(rng),
    )


def _size(rng: np.random.Generator) -> tuple[Frame, int, int]:
    """The photographs' size, how many, and samples, together within what a capture may cost."""
    across, up = _RATIOS[_choice(rng, table.SHAPES)]
    area = min(across, up) / max(across, up)
    most = table.PIXEL_SAMPLES / table.LEAST_SAMPLES / area
    (least, high), (small, large) = table.PHOTOGRAPHS_LOG, table.LONGER_LOG
    photographs = round(_log(rng, (least, min(high, most / small**2))))
    longer = round(_log(rng, (small, min(large, np.sqrt(most / photographs)))))
    width, height = (round(longer * side / max(across, up)) for side in (across, up))
    samples = int(table.PIXEL_SAMPLES / (width * height * photographs))
    frame = Frame(width, height, _even(rng, table.ANGLE))
    return frame, photographs, int(np.clip(samples, table.LEAST_SAMPLES, table.MOST_SAMPLES))
