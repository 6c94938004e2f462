# SPDX-License-Identifier: Apache-2.0
"""The recovered tone curve as JSON, look-up table and plot."""

from __future__ import annotations

import io
import itertools
import math
from typing import Any

from PIL import Image, ImageDraw, ImageFont

from robir.evaluation.layers import TONE_CURVE, stored_facts
from robir.jobs.paths import JobPaths, replacing, write_json
from robir.maths import tone

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
