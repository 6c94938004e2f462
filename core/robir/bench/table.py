# SPDX-License-Identifier: Apache-2.0
"""The scores of a bench as Markdown: a row a run, then median and worst of each variant."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from statistics import median
from typing import Any

from robir.bench.scores import COSTS, SCORES, Score

_CLIPPING = "standard"


def markdown(records: Iterable[dict[str, Any]]) -> str:
    """Two tables: all runs, and the summary of each preset and variant."""
    done, failed = [], []
    for record in records:
        (failed if "error" in record else done).append(record)
    titles = [column.title for column in (*SCORES, *COSTS)]
    head = ["capture", "preset", "variant", "seed", *titles, "tone curve"]
    rows = [_run_row(record) for record in done]
    parts = [
        "# Scores",
        "",
        *_table(["over all runs", *titles, "clipping told right"], _summary(done)),
    ]
    parts += ["", "## Runs", "", *_table(head, rows)]
    if failed:
        parts += ["", "## Failed", "", *(f"- {r['name']}: {r['error']}" for r in failed)]
    return "\n".join(parts) + "\n"


def _run_row(record: dict[str, Any]) -> list[str]:
    tone = record["scores"]["tone_curve"]
    return [
        *(str(record[key]) for key in ("capture", "preset", "variant", "seed")),
        *(score.text(_value(score, record)) for score in (*SCORES, *COSTS)),
        f"{tone['family']} / {tone['true_view_transform']}",
    ]


def _summary(records: Sequence[dict[str, Any]]) -> list[list[str]]:
    groups = dict.fromkeys((record["preset"], record["variant"]) for record in records)
    rows = []
    for preset, variant in groups:
        members = [r for r in records if (r["preset"], r["variant"]) == (preset, variant)]
        right = sum(_is_clipping_told_right(record) for record in members)
        for name in ("median", "worst"):
            cells = [_summarised(score, members, name) for score in (*SCORES, *COSTS)]
            rows.append([f"{preset}, {variant}: {name}", *cells, f"{right}/{len(members)}"])
    return rows


def _summarised(score: Score, members: Sequence[dict[str, Any]], name: str) -> str:
    values = [value for r in members if (value := _value(score, r)) is not None]
    if not values:
        return "-"
    return score.text(median(values) if name == "median" else max(values, key=score.badness))


def _value(score: Score, record: dict[str, Any]) -> float | None:
    return score.value(record if score in COSTS else record["scores"])


def _is_clipping_told_right(record: dict[str, Any]) -> bool:
    """Whether a curve that clips is told from one that rolls off."""
    tone = record["scores"]["tone_curve"]
    return (tone["family"] == _CLIPPING) == (tone["true_view_transform"].lower() == _CLIPPING)


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    lines = [head, ["---"] * len(head), *rows]
    return ["| " + " | ".join(line) + " |" for line in lines]
