# SPDX-License-Identifier: Apache-2.0
"""The speed-accuracy chart: what each second buys, one panel a score, the Pareto front marked."""

from __future__ import annotations

import io
from collections.abc import Sequence
from statistics import median
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, StrMethodFormatter

from robir_bench.distribution import estimate, quantile, worst_tenth
from robir_bench.table import Record, value
from robir_bench.truth.scores import ALBEDO, RERENDER, SECONDS, SHADOW, Score

PANELS = (ALBEDO, SHADOW, RERENDER)

_MARKERS = "osD^vP*X<>hp"
_PALETTE = (
    "#c8502d", "#2f6db0", "#3f9a5f", "#8a56a8", "#b8892b",
    "#4aa3a8", "#d0699a", "#6b7480", "#20262d", "#95b53c",
)  # fmt: skip
# text stays text, and equal figures are equal files
SVG_STYLE: Any = {"svg.fonttype": "none", "svg.hashsalt": "robir", "font.size": 9.0}


def speed_accuracy(records: Sequence[Record]) -> str:
    """The chart as SVG text.

    Large markers are medians over captures and seeds with their bootstrap intervals, dashes what
    nine runs in ten are no worse than; small markers are runs.

    Args:
        records: Runs that were scored.
    """
    methods = list(dict.fromkeys(record["method"] for record in records))
    with rc_context(SVG_STYLE):
        figure = Figure(figsize=(12.0, 4.3), layout="constrained")
        panels = figure.subplots(1, len(PANELS))
        for axes, score in zip(panels, PANELS, strict=True):
            _draw_panel(axes, score, records, methods)
        handles, labels = panels[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=6, frameon=False)
        return svg(figure)


def medians(score: Score, records: Sequence[Record]) -> dict[str, tuple[float, float]]:
    """Median seconds and score of each method that has any."""
    found: dict[str, tuple[float, float]] = {}
    for method in dict.fromkeys(record["method"] for record in records):
        points = [_point(score, record) for record in records if record["method"] == method]
        known = [point for point in points if point is not None]
        if known:
            found[method] = (median(p[0] for p in known), median(p[1] for p in known))
    return found


def amounts(records: Sequence[Record]) -> dict[str, list[tuple[float, float, float | None]]]:
    """Amount, CPU seconds and albedo (dB) by factor, of factors with two amounts or more.

    Amounts are the numbers of a factor's values, sums of lists of numbers, ascending; seconds
    and albedo are medians over captures, methods and seeds.
    """
    runs: dict[str, dict[float, list[tuple[float, float | None]]]] = {}
    for record in records:
        amount, seconds = _amount(record["value"]), value(SECONDS, record)
        if record["factor"] and amount is not None and seconds is not None:
            by_amount = runs.setdefault(record["factor"], {})
            by_amount.setdefault(amount, []).append((seconds, value(ALBEDO, record)))
    return {
        factor: [(amount, *_middle(by_amount[amount])) for amount in sorted(by_amount)]
        for factor, by_amount in runs.items()
        if len(by_amount) > 1
    }


def _middle(members: Sequence[tuple[float, float | None]]) -> tuple[float, float | None]:
    """Median seconds, and median albedo of those that have any."""
    albedos = [albedo for _, albedo in members if albedo is not None]
    return median(seconds for seconds, _ in members), median(albedos) if albedos else None


def _amount(label: str) -> float | None:
    """A positive amount that a value states, as of 400 or [64, 96, 128]; None of other words."""
    try:
        amount = sum(float(part) for part in label.strip("[]()").split(","))
    except ValueError:
        return None
    return amount if amount > 0 else None


def cost_growth(records: Sequence[Record]) -> str:
    """How seconds grow with amounts, and what albedo they buy, as SVG text; "" without amounts."""
    found = amounts(records)
    if not found:
        return ""
    with rc_context(SVG_STYLE):
        figure = Figure(figsize=(12.0, 4.6), layout="constrained")
        left, right = figure.subplots(1, 2)
        low = min(rows[0][0] / rows[-1][0] for rows in found.values())
        left.plot(
            [low, 1.0], [low, 1.0], "--", color="#20262d", linewidth=1.0, label="in proportion"
        )
        for index, (factor, rows) in enumerate(found.items()):
            style: dict[str, Any] = {
                "color": _PALETTE[index % len(_PALETTE)],
                "marker": _MARKERS[index % len(_MARKERS)],
                "markersize": 5,
            }
            most = rows[-1]
            left.plot(
                [r[0] / most[0] for r in rows],
                [r[1] / most[1] for r in rows],
                label=factor,
                **style,
            )
            known = [(r[1], r[2]) for r in rows if r[2] is not None]
            right.plot(*_columns(known), **style)
        left.set_xscale("log")
        left.set_yscale("log")
        for axis in (left.xaxis, left.yaxis):
            axis.set_minor_locator(LogLocator(subs=(2.0, 5.0)))
            axis.set_major_formatter(StrMethodFormatter("{x:.2g}"))
            axis.set_minor_formatter(StrMethodFormatter("{x:.2g}"))
        left.set_xlabel("amount, of the largest")
        left.set_ylabel("CPU seconds, of those at the largest")
        right.set_xlabel("CPU seconds")
        right.set_ylabel(ALBEDO.title)
        for axes in (left, right):
            tidy(axes)
        handles, labels = left.get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=5, frameon=False)
        return svg(figure)


def pareto_front(points: Sequence[tuple[float, float]]) -> list[int]:
    """Indices of the points that no other point beats, cheapest first.

    Args:
        points: Cost and badness; smaller is better for both.
    """
    order = sorted(range(len(points)), key=lambda index: points[index])
    front: list[int] = []
    for index in order:
        if not front or points[index][1] < points[front[-1]][1]:
            front.append(index)
    return front


def svg(figure: Figure) -> str:
    """A figure as SVG text that is the same every time."""
    stream = io.StringIO()
    figure.savefig(stream, format="svg", metadata={"Date": None, "Creator": None})
    text = stream.getvalue()
    return text[text.index("<svg") :]


def _draw_panel(
    axes: Axes, score: Score, records: Sequence[Record], methods: Sequence[str]
) -> None:
    found, sign = medians(score, records), -1.0 if score.best == "high" else 1.0
    for index, method in enumerate(methods):
        style: dict[str, Any] = {
            "color": _PALETTE[index % len(_PALETTE)],
            "marker": _MARKERS[index % len(_MARKERS)],
        }
        points = [_point(score, record) for record in records if record["method"] == method]
        known = [point for point in points if point is not None]
        axes.plot(*_columns(known), linestyle="", markersize=3.5, alpha=0.35, **style)
        if method in found:
            _draw_median(axes, found[method], _columns(known)[1], sign, label=method, **style)
    middle = list(found.values())
    front = [middle[i] for i in pareto_front([(s, sign * v) for s, v in middle])]
    axes.plot(
        *_columns(front),
        linestyle="--",
        linewidth=1.0,
        marker="o",
        markersize=14,
        markerfacecolor="none",
        color="#20262d",
        label="Pareto front",
        zorder=0,
    )
    axes.set_xscale("log")
    for setter in (axes.xaxis.set_major_formatter, axes.xaxis.set_minor_formatter):
        setter(StrMethodFormatter("{x:.0f}"))
    axes.set_xlabel("CPU seconds")
    wanted = "higher is better" if score.best == "high" else "lower is better"
    axes.set_title(wanted, fontsize=8, loc="right")
    axes.set_ylabel(f"{score.title}, distance from 1" if score.best == "one" else score.title)
    tidy(axes)


def _draw_median(
    axes: Axes, middle: tuple[float, float], values: Sequence[float], sign: float, **style: Any
) -> None:
    """A method's medians, its values' interval, and what nine in ten are no worse than.

    Values times `sign` are larger for worse.
    """
    figure = estimate(values, quantile(0.5))
    reach = [0.0, 0.0]
    if figure is not None and figure.low is not None and figure.high is not None:
        reach = [figure.value - figure.low, figure.high - figure.value]
    seconds, value = middle
    axes.errorbar(
        [seconds], [value], np.transpose([reach]), linestyle="", markersize=8, capsize=2.5, **style
    )
    tenth = worst_tenth(values, lambda value: sign * value)
    axes.plot([seconds], [tenth], marker="_", markersize=12, linestyle="", color=style["color"])


def tidy(axes: Axes) -> None:
    """Faint grid, and no frame but the two axes."""
    axes.grid(visible=True, which="both", color="#e3e7eb", linewidth=0.6)
    axes.spines[["top", "right"]].set_visible(False)


def _point(score: Score, record: Record) -> tuple[float, float] | None:
    """Seconds and score; of a ratio how far it is from 1, since medians of ratios cancel."""
    seconds, found = value(SECONDS, record), value(score, record)
    if seconds is None or found is None:
        return None
    return seconds, score.badness(found) if score.best == "one" else found


def _columns(points: Sequence[tuple[float, float]]) -> tuple[list[float], list[float]]:
    return [point[0] for point in points], [point[1] for point in points]
