# SPDX-License-Identifier: Apache-2.0
"""Two charts of a bench: calibration of the uncertainty, and recovered against true tone curves."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from robir.maths import tone
from robir.maths.tone_curve import DISPLAY_POWER
from robir_bench.chart import SVG_STYLE, svg, tidy
from robir_bench.table import Record
from robir_bench.truth.light import CODES, grey_radiance, true_curve

_INK, _ACCENT, _MUTED = "#20262d", "#c8502d", "#9aa4ae"
_COLUMNS = 4
WANTED = (0.85, 0.95)  # where the observed share of the 90 % band must lie over a bench


def calibration(records: Sequence[Record]) -> str | None:
    """Nominal against observed shares of the uncertainty's bands, as SVG text.

    Args:
        records: Runs that were scored.

    Returns:
        The chart, or None if no run states an uncertainty.
    """
    stated = [r["scores"]["uncertainty"] for r in records if r["scores"].get("uncertainty")]
    if not stated:
        return None
    nominal = stated[0]["nominal"]
    with rc_context(SVG_STYLE):
        figure = Figure(figsize=(4.8, 4.4), layout="constrained")
        axes = figure.subplots()
        axes.plot([0.4, 1.0], [0.4, 1.0], color=_INK, linewidth=0.8, linestyle=":")
        for index, each in enumerate(stated):
            label = "a run" if index == 0 else None
            axes.plot(nominal, each["observed"], color=_MUTED, linewidth=0.8, label=label)
        pooled = np.mean([each["observed"] for each in stated], axis=0)
        axes.plot(nominal, pooled, color=_ACCENT, marker="o", label=f"mean of {len(stated)} runs")
        axes.vlines(0.9, *WANTED, color=_INK, linewidth=3.0, alpha=0.4, label="wanted at 90 %")
        axes.set_xlabel("share of the truth that a band promises")
        axes.set_ylabel("share that it holds")
        axes.set_xlim(0.45, 1.0)
        axes.set_ylim(0.25, 1.0)
        tidy(axes)
        axes.legend(frameon=False, loc="lower right")
        return svg(figure)


def tone_curves(records: Sequence[Record]) -> str | None:
    """Recovered against true curves as SVG text, a panel for each true one.

    Recovered curves are shifted by the mean exposure between the two, which is no part of a curve.

    Args:
        records: Runs that were scored.

    Returns:
        The chart, or None if no run has a known true curve.
    """
    panels: dict[str, list[tuple[tone.AbstractToneCurve, tone.AbstractToneCurve]]] = {}
    for record in records:
        told = record["scores"]["tone_curve"]
        power = told.get("true_display_power", 1.0)
        truth = true_curve({"view_transform": told["true_view_transform"], DISPLAY_POWER: power})
        if truth is not None:
            name = told["true_view_transform"] + (f" ^ {power:g}" if power != 1.0 else "")
            found = tone.curve_from_name(told["family"], told.get("parameters"))
            panels.setdefault(name, []).append((truth, found))
    if not panels:
        return None
    rows, columns = -(-len(panels) // _COLUMNS), min(len(panels), _COLUMNS)
    with rc_context(SVG_STYLE):
        figure = Figure(figsize=(3.6 * columns, 3.2 * rows), layout="constrained")
        grid = figure.subplots(rows, columns, squeeze=False).ravel()
        for axes, name in zip(grid, panels, strict=False):
            _draw_curves(axes, name, panels[name])
        for axes in grid[len(panels) :]:
            axes.set_visible(False)
        return svg(figure)


def _draw_curves(
    axes: Axes, name: str, pairs: Sequence[tuple[tone.AbstractToneCurve, tone.AbstractToneCurve]]
) -> None:
    true = np.log2(grey_radiance(pairs[0][0]))
    counts: dict[str, int] = {}
    for _truth, found in pairs:
        label = curve_label(found)
        counts[label] = counts.get(label, 0) + 1
    drawn = {curve_label(found): found for _truth, found in pairs}
    for label, found in drawn.items():
        ours = np.log2(grey_radiance(found))
        shifted = ours - (ours - true).mean()
        apart = (ours - true).std()
        text = f"{label}, {counts[label]} x, {apart:.2f} stops"
        axes.plot(shifted, CODES, linewidth=1.6, label=text)
    axes.plot(true, CODES, color=_INK, linewidth=1.2, linestyle="--", label="true")
    axes.set_title(f"true: {name}", fontsize=9)
    axes.set_xlabel("log2 of grey radiance")
    axes.set_ylabel("display code / 255")
    tidy(axes)
    axes.legend(frameon=False, fontsize=7, loc="upper left")


def curve_label(curve: tone.AbstractToneCurve) -> str:
    """Family with its parameters."""
    numbers = ", ".join(f"{name} {value:g}" for name, value in curve.parameters.items())
    return f"{curve.name} ({numbers})" if numbers else curve.name
