# SPDX-License-Identifier: Apache-2.0
"""The recovered tone curve as JSON, look-up table and plot."""

from __future__ import annotations

import io
import itertools
from typing import Any

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from robir.jobs.paths import JobPaths, read_json, replacing, write_json
from robir.maths import tone

_SAMPLES = 129
_CUBE_SIZE = 33
_INK, _ACCENT, _MUTED = "#1d2733", "#c8502d", "#7d8894"
_STYLES = ("-", "--", "-.", ":")
_TICKS = {0.25**step: "1" if not step else f"1/{4**step}" for step in range(5, -1, -1)} | {
    4.0: "4",
    16.0: "16",
}
"""Plain text: to set powers as mathematics takes most of the time of a plot."""


def export_tone_curve(paths: JobPaths) -> dict[str, Any]:
    """Write tone_curve.json, .cube and .png.

    The JSON is the appearance stage's with "samples" added: grey radiance "linear" against the
    "display" code in 0..1.

    Returns:
        The JSON's content.
    """
    table = read_json(paths.stage("appearance") / "tone_curve.json")
    curve = tone.curve_from_name(table["family"], table["parameters"])
    table = table | {"samples": tone.as_samples(curve, _SAMPLES)}
    write_json(paths.tone_curve, table)
    with replacing(paths.tone_lut) as temporary:
        temporary.write_text(tone.cube_text(curve, _CUBE_SIZE), encoding="ascii")
    with replacing(paths.tone_plot) as temporary:
        temporary.write_bytes(_plot(table))
    return table


def _plot(table: dict[str, Any]) -> bytes:
    """The chosen curve over the other candidates as PNG."""
    figure = Figure(figsize=(6.4, 3.8), dpi=130)
    # a layout that is solved for draws everything thrice
    figure.subplots_adjust(left=0.085, right=0.985, bottom=0.125, top=0.975)
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    samples = table["samples"]
    axes.plot(
        samples["linear"], samples["display"], color=_ACCENT, linewidth=2.6, label=table["family"]
    )
    others = [c["family"] for c in table["candidates"] if c["family"] != table["family"]]
    for family, style in zip(others, itertools.cycle(_STYLES)):
        samples = tone.as_samples(tone.curve_from_name(family), _SAMPLES)
        axes.plot(
            samples["linear"],
            samples["display"],
            color=_MUTED,
            linewidth=1.1,
            linestyle=style,
            label=family,
            zorder=1,
        )
    axes.axvline(0.18, color=_INK, linewidth=0.6, linestyle=":")
    axes.set_xscale("log", base=2)
    axes.set_xticks(list(_TICKS), list(_TICKS.values()))
    axes.set_xlabel("scene radiance, linear (dotted: 0.18)")
    axes.set_ylabel("display code / 255")
    axes.set_ylim(0.0, 1.02)
    axes.legend(frameon=False, loc="upper left", fontsize=9)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    stream = io.BytesIO()
    figure.savefig(stream, format="png")
    return stream.getvalue()
