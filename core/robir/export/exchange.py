# SPDX-License-Identifier: Apache-2.0
"""The cameras, light and tone curve of a result, in our own form and in those of other programs.

`cameras.json` is what the add-on reads. `transforms.json` is nerfstudio's and instant-ngp's, and
`colmap` a sparse model in text, whose photographs lie in stages/capture/views. All are in the
capture's frame and unit, of the photographs as cut and undistorted, the mask their alpha.

A Sun lamp is a disc of even radiance, a lobe fades away from its axis. Two figures make them light
a surface alike: the irradiance on a surface that faces the lamp, and the mean of the cosine about
the axis, which for a cone of half-angle a is (1 + cos a) / 2.
"""

from __future__ import annotations

import io
import itertools
import math
import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont
from scipy.spatial.transform import Rotation

from robir.capture.capture import Capture
from robir.capture.frames import OPENGL_FROM_OPENCV
from robir.capture.store import plain_view, view_path
from robir.evaluation.layers import TONE_CURVE, stored_facts
from robir.evaluation.light import RecoveredLight, load_light
from robir.export.textures import write_exr
from robir.jobs.paths import JobPaths, read_json, replacing, write_json
from robir.jobs.records import NUMBERS
from robir.maths import spherical_gaussian as sg
from robir.maths import tone

_GROUND = {"normal": NUMBERS, "offset": float}
_MOST_POINTS = 20_000  # points of the sparse model: splats begin from them


def export_cameras(
    paths: JobPaths, capture: Capture, points: NDArray[np.floating] | None = None
) -> None:
    """Write every view with its photograph, bounds and ground, and points (N, 3), capture frame."""
    folder = paths.stage("capture")
    photos = [
        Path(os.path.relpath(view_path(folder, view.name), paths.cameras.parent)).as_posix()
        for view in capture.views
    ]
    centre, radius = capture.bounds.centre, capture.bounds.radius
    table: dict[str, Any] = {
        "views": [
            {**plain_view(view), "image": photo}
            for view, photo in zip(capture.views, photos, strict=True)
        ],
        "bounds": {"centre": centre.tolist(), "radius": radius},
    }
    if paths.ground.is_file():
        plane = stored_facts(paths.ground, _GROUND)
        away = sum(n * c for n, c in zip(plane["normal"], centre.tolist(), strict=True))
        table["ground"] = plane | {"offset": radius * plane["offset"] + away}
    write_json(paths.cameras, table)
    write_json(paths.transforms, _transforms(capture, photos))
    _write_colmap(paths.colmap / "sparse" / "0", capture, photos, points)


def _transforms(capture: Capture, photos: list[str]) -> dict[str, Any]:
    frames, names = [], {"train": [], "held_out": []}
    for view, photo in zip(capture.views, photos, strict=True):
        camera = view.camera
        names[view.split].append(photo)
        frame = {"file_path": photo, "transform_matrix": camera.camera_to_world.tolist()}
        frame |= {"w": camera.width, "h": camera.height, "fl_x": camera.fx, "fl_y": camera.fy}
        frames.append(frame | {"cx": camera.cx, "cy": camera.cy})
    held_out = {"val_filenames": names["held_out"], "test_filenames": names["held_out"]}
    split = {"train_filenames": names["train"], **held_out} if names["held_out"] else {}
    return {"camera_model": "OPENCV", **split, "frames": frames}


def _write_colmap(
    folder: Path, capture: Capture, photos: list[str], points: NDArray[np.floating] | None
) -> None:
    cameras, images = [], []
    for number, (view, photo) in enumerate(zip(capture.views, photos, strict=True), start=1):
        camera = view.camera
        lens = _words(camera.fx, camera.fy, camera.cx, camera.cy)
        cameras.append(f"{number} PINHOLE {camera.width} {camera.height} {lens}\n")
        look = np.linalg.inv(camera.camera_to_world @ OPENGL_FROM_OPENCV)
        x, y, z, w = Rotation.from_matrix(look[:3, :3]).as_quat()
        pose = _words(w, x, y, z, *look[:3, 3])
        images.append(f"{number} {pose} {number} {photo.rpartition('/')[2]}\n\n")
    chosen = np.zeros((0, 3)) if points is None else points[:: 1 + len(points) // _MOST_POINTS]
    cloud = [f"{i} {_words(*p)} 128 128 128 0\n" for i, p in enumerate(chosen, start=1)]
    folder.mkdir(parents=True, exist_ok=True)
    for name, lines in (("cameras", cameras), ("images", images), ("points3D", cloud)):
        with replacing(folder / f"{name}.txt") as file:
            file.write_text("".join(lines), encoding="utf-8")


def _words(*values: float) -> str:
    return " ".join(repr(float(value)) for value in values)


ROWS = 512

# Widest lobe that is given as a lamp, radians. Behind an edge at distance d a shadow fades over d
# times the diameter: at 15 degrees over a quarter of the way, and nothing crisp is left that a lamp
# could keep. A narrow disc and a lobe of the same mean cosine differ by 4 % of the lamp at most
# anywhere in a straight shadow's border.
MAX_LAMP_DIAMETER = math.radians(15.0)


def export_light(paths: JobPaths, radius: float) -> RecoveredLight:
    """Write environment.exr, 512 x 1024, light.json, and if there are suns one without them.

    Of a thing whose bounds have this radius, capture's unit.
    """
    table = paths.stage("appearance") / "light.json"
    light = load_light(table)
    lamps = sun_lamps(light, radius)
    write_json(paths.light, {**read_json(table), "sun_lamps": lamps})
    write_exr(paths.environment, light.environment(ROWS))
    if lamps:
        kept = np.ones(len(light.is_sharp), bool)
        kept[[lamp["lobe"] for lamp in lamps]] = False
        rest = replace(
            light, lobes=light.chosen(torch.from_numpy(kept)), is_sharp=light.is_sharp[kept]
        )
        write_exr(paths.environment_without_sun, rest.environment(ROWS))
    else:
        paths.environment_without_sun.unlink(missing_ok=True)
    return light


def sun_lamps(light: RecoveredLight, radius: float) -> list[dict[str, Any]]:
    """The sharp lobes that are narrow enough for a lamp, in the order of the lobes.

    "lobe": index into the lobes; "direction": unit, world, towards the light; "irradiance": linear
    Rec.709, of a surface that faces the lamp, radiance times steradian (Blender's strength of a Sun
    lamp, W/m2); "angular_diameter": of a disc with the lobe's mean cosine, radians. Of a lamp that
    stands near, all as the centre of the bounds sees it, which is "distance" away (capture's unit).
    """
    place = {"distance": radius * light.distance} if math.isfinite(light.distance) else {}
    sharpness = light.lobes.sharpness.double()
    diameter = 4.0 * torch.asin(torch.sqrt(1.0 - sg.mean_cosine(sharpness)))
    irradiance = sg.integral(light.lobes) * sg.cosine_shares(
        sharpness, torch.ones_like(sharpness)
    ).unsqueeze(-1)
    return [
        {
            "lobe": index,
            "direction": light.lobes.axis[index].tolist(),
            "irradiance": irradiance[index].tolist(),
            "angular_diameter": float(diameter[index]),
            **place,
        }
        for index in np.flatnonzero(light.is_sharp).tolist()
        if diameter[index] <= MAX_LAMP_DIAMETER
    ]


def light_told(evidence: list[dict[str, Any]], of: str) -> list[dict[str, Any]]:
    """Estimates of the light's "level" or "hue": "by", "times" the last row, "within" a factor."""
    rows = [row for row in evidence if row["of"] == of]
    base = rows[-1]["value"] if rows and of == "level" else 0.0
    return [
        {
            "by": row["by"],
            "times": round(float(np.exp(row["value"] - base)), 3),
            "within": round(float(np.exp(row["deviation"])), 3),
        }
        for row in rows
    ]


_SAMPLES = 129
_CUBE_SIZE = 33
_INK, _ACCENT = "#1d2733", "#c8502d"
_MUTED = ("#7d8894", "#4f81b8", "#6aa06a", "#a58bbd", "#b8a05a")
_TICKS = {0.25**step: "1" if not step else f"1/{4**step}" for step in range(5, -1, -1)} | {
    4.0: "4",
    16.0: "16",
}
_SIZE = (832, 494)
# the plot's axes and the whole picture, pixels
_LEFT, _TOP, _RIGHT, _BOTTOM = 62.0, 40.0, 816.0, 432.0
_FORM = TONE_CURVE | {
    "candidates": [{
        "family": str, "score": float, "standard_error": (None, float),
        "albedo_apart": (None, float),
    }],
    "clipped_share": float, "blender_view_transform": (None, str), "blender_gamma?": float,
    "exposure": float,
}  # fmt: skip

_SCALE = 2  # drawn so much larger and reduced, for smooth lines


def export_tone_curve(paths: JobPaths) -> dict[str, Any]:
    """Write tone_curve.json, with "samples" of linear and display grey, .cube and .png."""
    table = stored_facts(paths.stage("appearance") / "tone_curve.json", _FORM)
    curve = tone.curve_from_name(table["family"], table["parameters"])
    table = table | {"samples": tone.as_samples(curve, _SAMPLES)}
    write_json(paths.tone_curve, table)
    with replacing(paths.tone_lut) as temporary:
        temporary.write_text(tone.cube_text(curve, _CUBE_SIZE), encoding="ascii")
    with replacing(paths.tone_plot) as temporary:
        temporary.write_bytes(_plot(table))
    return table


def _plot(table: dict[str, Any]) -> bytes:
    """The chosen curve over the other candidates as PNG; matplotlib would take a second to load."""
    picture = Image.new("RGB", (_SCALE * _SIZE[0], _SCALE * _SIZE[1]), "white")
    pen, font = ImageDraw.Draw(picture), ImageFont.load_default(_SCALE * 14)

    def write(x: float, y: float, words: str, anchor: str) -> None:
        pen.text((_SCALE * x, _SCALE * y), words, fill=_INK, font=font, anchor=anchor)

    def line(points: list[tuple[float, float]], colour: str, width: float) -> None:
        ends = [(_SCALE * x, _SCALE * y) for x, y in points]
        pen.line(ends, fill=colour, width=round(_SCALE * width), joint="curve")

    write(_RIGHT, _BOTTOM + 38, "scene radiance, linear (line: 0.18)", "rm")
    write(_LEFT - 44, _TOP - 20, "display code / 255", "lm")
    for linear, words in _TICKS.items():
        x, y = _place(linear, 0.0)
        line([(x, y), (x, y + 5)], _INK, 1)
        write(x, y + 17, words, "mm")
    for fifth in range(6):
        x, y = _LEFT, _place(1.0, fifth / 5)[1]
        line([(x - 5, y), (x, y)], _INK, 1)
        write(x - 10, y, f"{fifth / 5:.1f}", "rm")
    line([(_LEFT, _TOP), (_LEFT, _BOTTOM), (_RIGHT, _BOTTOM)], _INK, 1)
    line([_place(0.18, 0.0), _place(0.18, 1.0)], _INK, 0.5)
    others = [c["family"] for c in table["candidates"] if c["family"] != table["family"]]
    drawn = [(family, tone.as_samples(tone.curve_from_name(family), _SAMPLES)) for family in others]
    styles = [(colour, 1.5) for colour, _ in zip(itertools.cycle(_MUTED), others)]
    rows = [*zip(drawn, styles, strict=True), ((table["family"], table["samples"]), (_ACCENT, 4.0))]
    for row, ((family, samples), (colour, width)) in enumerate(rows):
        line([*map(_place, samples["linear"], samples["display"])], colour, width)
        x, y = _LEFT + 16, _TOP + 14 + 24 * (row + 1) % (24 * len(rows))  # the chosen one on top
        line([(x, y), (x + 34, y)], colour, width)
        write(x + 46, y, family, "lm")
    stream = io.BytesIO()
    picture.resize(_SIZE, Image.Resampling.BOX).save(stream, format="png")
    return stream.getvalue()


def _place(linear: float, display: float) -> tuple[float, float]:
    """Where a radiance and its display code, 0 to 1, lie in the plot, pixels."""
    low, high = math.log2(min(_TICKS)), math.log2(max(_TICKS))
    along = (math.log2(linear) - low) / (high - low)
    return _LEFT + 30 + along * (_RIGHT - _LEFT - 60), _BOTTOM - display * (_BOTTOM - _TOP)
