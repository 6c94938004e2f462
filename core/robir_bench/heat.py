# SPDX-License-Identifier: Apache-2.0
"""What each factor costs: losses against the unperturbed runs, their heat map, the worst cases."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from statistics import median
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from robir_bench.chart import SVG_STYLE, svg
from robir_bench.table import Record, Table, value
from robir_bench.truth.scores import ALBEDO, SHADOW

# a run whose albedo is this far below the median of its scene's unperturbed runs is wrong
MISLED_DECIBEL = 6.0

_KEYS = ("capture", "method", "seed")


@dataclass(frozen=True, slots=True, kw_only=True)
class Case:
    """A spoilt run beside the run on the capture as it was."""

    record: Record  # of the spoilt run
    base: Record | None  # of the unperturbed run, or None if that failed
    lost: float | None  # decibel of albedo lost, or None where either failed
    shadow: float | None  # shadow ratio, or None

    @property
    def row(self) -> tuple[str, str]:
        """Factor and value."""
        return self.record["factor"], self.record["value"]

    @property
    def badness(self) -> float:
        """Larger is worse; a failed run is the worst."""
        return float("inf") if self.lost is None else self.lost


def cases(records: Iterable[Record]) -> list[Case]:
    """Every spoilt run with its loss."""
    everything = list(records)
    bases = {
        tuple(r[key] for key in _KEYS): r for r in everything if not r["factor"] and "scores" in r
    }
    found = []
    for record in everything:
        if not record["factor"]:
            continue
        base = bases.get(tuple(record[key] for key in _KEYS))
        ours = value(ALBEDO, record) if "scores" in record else None
        before = None if base is None else value(ALBEDO, base)
        found.append(
            Case(
                record=record,
                base=base,
                lost=None if ours is None or before is None else before - ours,
                shadow=value(SHADOW, record) if "scores" in record else None,
            )
        )
    return found


def worst_cases(found: Sequence[Case]) -> list[Case]:
    """The worst case of each factor, in the factors' order."""
    factors = dict.fromkeys(case.record["factor"] for case in found)
    return [
        max((case for case in found if case.record["factor"] == name), key=lambda c: c.badness)
        for name in factors
    ]


def heat_table(found: Sequence[Case]) -> Table:
    """A row each factor and value: median loss, shadow ratio and failures of each method."""
    methods = _methods(found)
    head = ["factor", "value"]
    for method in methods:
        head += [f"{method}: albedo lost (dB)", "shadow ratio", "failed"]
    rows = []
    for row in dict.fromkeys(case.row for case in found):
        cells = list(row)
        for method in methods:
            lost, shadow, failed, count = _cell(found, row, method)
            cells += [_text(lost, 1), _text(shadow, 2), f"{failed} of {count}"]
        rows.append(cells)
    return Table(title="What each factor costs", head=head, rows=rows)


def heat_map(found: Sequence[Case]) -> str:
    """The table as a picture, SVG text: a panel for the loss, one for the shadow ratio."""
    rows, methods = list(dict.fromkeys(case.row for case in found)), _methods(found)
    cells = [[_cell(found, row, method) for method in methods] for row in rows]
    size = (4.2 + 2.2 * len(methods), 1.3 + 0.32 * len(rows))
    with rc_context(SVG_STYLE):
        figure = Figure(figsize=size, layout="constrained")
        left, right = figure.subplots(1, 2, sharey=True)
        lost = [[cell[0] for cell in line] for line in cells]
        _draw_heat(left, lost, "albedo lost (dB)", (-1.0, 10.0), "OrRd")
        shadow = [[cell[1] for cell in line] for line in cells]
        _draw_heat(right, shadow, "shadow ratio (1 is best)", (0.0, 2.0), "PuOr")
        for axes in (left, right):
            axes.set_xticks(range(len(methods)), methods)
            axes.tick_params(length=0)
            for y, line in enumerate(cells):
                for x, (_lost, _shadow, failed, count) in enumerate(line):
                    if failed:
                        axes.text(x, y + 0.36, f"{failed} of {count} failed", ha="center", size=6)
        left.set_yticks(range(len(rows)), [f"{factor} {label}" for factor, label in rows])
        return svg(figure)


def cause(case: Case) -> str:
    """A sentence on what went wrong, from the scores that moved."""
    if "error" in case.record:
        return "The run ended without a result."
    if case.base is None:
        return "The run on the capture as it was failed, so there is nothing to compare with."
    now, before = case.record["scores"], case.base["scores"]
    parts = [
        sentence
        for sentence in (
            _outline(now, before),
            _normals(now, before),
            _sun(now, before),
            _tone(now, before),
            _shadow(now, before),
        )
        if sentence
    ]
    if not parts:
        return "Shape, sun, tone curve and shadows stayed as they were."
    text = "; ".join(parts)
    return text[0].upper() + text[1:] + "."


def told(record: Record) -> list[str]:
    """What the program itself said about a run."""
    if "error" in record:
        return [f"exit code {record['exit_code']}: {record['error']}"]
    trust = record["trust"]
    said = [f"{warning[:1].upper()}{warning[1:].rstrip('.')}." for warning in record["warnings"]]
    return said or (["The result is to be trusted."] if trust and trust["is_trusted"] else [])


def vigilance(records: Iterable[Record]) -> dict[str, int]:
    """How well the program's own check tells wrong results; a refused run tells of itself.

    Returns:
        "wrong" and "told" (wrong runs, and those flagged), "sound" and "alarms" (the others, and
        those flagged).
    """
    everything = [r for r in records if "error" in r or r.get("trust") is not None]
    usual = _usual_albedo(everything)
    counts = {"wrong": 0, "told": 0, "sound": 0, "alarms": 0}
    for record in everything:
        if "error" in record:
            is_wrong = is_flagged = True
        elif _group(record) in usual:
            below = usual[_group(record)] - (value(ALBEDO, record) or 0.0)
            is_wrong, is_flagged = below > MISLED_DECIBEL, not record["trust"]["is_trusted"]
        else:
            continue
        counts["wrong" if is_wrong else "sound"] += 1
        if is_flagged:
            counts["told" if is_wrong else "alarms"] += 1
    return counts


def _usual_albedo(records: Sequence[Record]) -> dict[tuple[str, ...], float]:
    """Median albedo in dB of the unperturbed runs of each scene and method."""
    found: dict[tuple[str, ...], list[float]] = {}
    for record in records:
        if "scores" in record and not record["factor"]:
            found.setdefault(_group(record), []).append(value(ALBEDO, record) or 0.0)
    return {group: median(albedos) for group, albedos in found.items()}


def _group(record: Record) -> tuple[str, ...]:
    return record["capture"], record["method"]


def _methods(found: Sequence[Case]) -> list[str]:
    return list(dict.fromkeys(case.record["method"] for case in found))


def _cell(
    found: Sequence[Case], row: tuple[str, str], method: str
) -> tuple[float | None, float | None, int, int]:
    """Median loss and shadow ratio, failed runs and all runs."""
    members = [c for c in found if c.row == row and c.record["method"] == method]
    lost = [case.lost for case in members if case.lost is not None]
    shadow = [case.shadow for case in members if case.shadow is not None]
    failed = sum("error" in case.record for case in members)
    return median(lost) if lost else None, median(shadow) if shadow else None, failed, len(members)


def _draw_heat(
    axes: Axes,
    numbers: list[list[float | None]],
    title: str,
    limits: tuple[float, float],
    palette: str,
) -> None:
    image = np.array([[np.nan if n is None else n for n in line] for line in numbers], float)
    axes.imshow(image, aspect="auto", vmin=limits[0], vmax=limits[1], cmap=palette, alpha=0.65)
    axes.set_title(title, fontsize=9)
    digits = 1 if limits[1] > 2 else 2
    for (y, x), number in np.ndenumerate(image):
        axes.text(
            x, y, _text(None if np.isnan(number) else number, digits), ha="center", va="center"
        )
    axes.spines[:].set_visible(False)


def _text(number: float | None, digits: int) -> str:
    return "-" if number is None else f"{number:.{digits}f}"


def _outline(now: dict[str, Any], before: dict[str, Any]) -> str:
    if before["mask_iou"] - now["mask_iou"] < 0.01:
        return ""
    return f"the outline is off (IoU {now['mask_iou']:.3f} against {before['mask_iou']:.3f})"


def _normals(now: dict[str, Any], before: dict[str, Any]) -> str:
    angle, was = now["normals"]["mean_degrees"], before["normals"]["mean_degrees"]
    if angle < 1.3 * was + 1.0:
        return ""
    return f"normals are {angle:.0f} degrees off against {was:.0f}"


def _sun(now: dict[str, Any], before: dict[str, Any]) -> str:
    angle, was = (s["light"]["strongest_lobe_degrees"] for s in (now, before))
    if angle is None and was is not None:
        return "no sun was found"
    if angle is None or angle < (was or 0.0) + 5.0:
        return ""
    return f"the sun is {angle:.0f} degrees off"


def _tone(now: dict[str, Any], before: dict[str, Any]) -> str:
    family, true = now["tone_curve"]["family"], now["tone_curve"]["true_view_transform"]
    if family == before["tone_curve"]["family"]:
        return ""
    return f"the tone curve, {true}, was taken for {family}"


def _shadow(now: dict[str, Any], before: dict[str, Any]) -> str:
    ratio, was = now["shadow"]["ratio"], before["shadow"]["ratio"]
    if ratio is None or was is None or abs(ratio - 1) < abs(was - 1) + 0.1:
        return ""
    kind = "shadows stay in the albedo" if ratio < 1 else "shadows are over-corrected"
    return f"{kind} (ratio {ratio:.2f} against {was:.2f})"
