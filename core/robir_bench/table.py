# SPDX-License-Identifier: Apache-2.0
"""The scores of a bench as tables: how each method does, ours against each, then a row a run."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from robir_bench.distribution import estimate, mean, quantile, worst_tenth
from robir_bench.plan import OURS
from robir_bench.truth.scores import ALBEDO, COSTS, LEVEL_SCORES, RAW_ALBEDO, SCORES, SECONDS, Score

Record = dict[str, Any]

_CLIPPING = "standard"
_SUMMARIES = ("median", "worst tenth", "worst")


@dataclass(frozen=True, slots=True, kw_only=True)
class Table:
    """A table for Markdown and HTML alike."""

    title: str  # heading
    head: Sequence[str]  # titles of the columns
    rows: Sequence[Sequence[str]]  # cells as shown

    def markdown(self) -> str:
        """The table with its heading."""
        lines = [self.head, ["---"] * len(self.head), *self.rows]
        return "\n".join([f"## {self.title}", "", *("| " + " | ".join(x) + " |" for x in lines)])


def bench_tables(records: Iterable[Record]) -> list[Table]:
    """Summary of each method, all runs, and those that failed."""
    done, failed = split(records)
    rendered = [record for record in done if is_rendered(record)]
    shown = [record for record in done if "levels" in record["scores"]]
    tables = _truth_tables(rendered) if rendered or not shown else []
    tables += [_level_table(shown)] if shown else []
    return tables + ([failures(failed)] if failed else [])


def is_rendered(record: Record) -> bool:
    """Whether a run that was scored could be compared with the truth."""
    return "albedo" in record["scores"]


def _truth_tables(records: Sequence[Record]) -> list[Table]:
    titles = [column.title for column in (*SCORES, *COSTS)]
    return [
        Table(
            title="Over all runs",
            head=["method", *titles, "clipping told right"],
            rows=_summary(records),
        ),
        *_against_each(records),
        Table(
            title="Runs",
            head=["capture", "method", "seed", *titles, "tone curve"],
            rows=[_run_row(record) for record in records],
        ),
    ]


def _level_table(records: Sequence[Record]) -> Table:
    """How well each level of the chain shows held-out photographs, and medians over all runs."""
    columns = (*LEVEL_SCORES, SECONDS)
    rows = [
        [
            *(str(record[key]) for key in ("capture", "method", "seed")),
            *(column.text(value(column, record)) for column in columns),
            _trusted(record),
            record["scores"]["levels"]["verdict"].partition(":")[0].rstrip("."),
        ]
        for record in records
    ]
    for method in dict.fromkeys(record["method"] for record in records):
        members = [record for record in records if record["method"] == method]
        trusted = sum(_trusted(record) == "yes" for record in members)
        for name in _SUMMARIES:
            cells = [_summarised(column, members, name) for column in columns]
            rows.append([name, method, "", *cells, f"{trusted}/{len(members)}", ""])
    titles = [column.title for column in columns]
    return Table(
        title="Held-out photographs, level by level",
        head=["capture", "method", "seed", *titles, "trusted", "most is lost"],
        rows=rows,
    )


def _trusted(record: Record) -> str:
    """Whether the program says that the result is to be trusted; some methods say nothing."""
    trust = record["trust"]
    return "-" if trust is None else "yes" if trust["is_trusted"] else "no"


def failures(failed: Sequence[Record]) -> Table:
    """Runs without a result and what they said."""
    return Table(
        title="Failed",
        head=["run", "exit code", "said"],
        rows=[[r["name"], str(r["exit_code"]), r["error"].replace("|", "/")] for r in failed],
    )


def split(records: Iterable[Record]) -> tuple[list[Record], list[Record]]:
    """Records with scores, and those of runs that failed."""
    done: list[Record] = []
    failed: list[Record] = []
    for record in records:
        (failed if "error" in record else done).append(record)
    return done, failed


def value(score: Score, record: Record) -> float | None:
    """A score or a cost of a run that was scored."""
    return score.value(record if score in COSTS else record["scores"])


def _run_row(record: Record) -> list[str]:
    tone = record["scores"]["tone_curve"]
    return [
        *(str(record[key]) for key in ("capture", "method", "seed")),
        *(score.text(value(score, record)) for score in (*SCORES, *COSTS)),
        f"{tone['family']} / {tone['true_view_transform']}",
    ]


def _summary(records: Sequence[Record]) -> list[list[str]]:
    rows = []
    for method in dict.fromkeys(record["method"] for record in records):
        members = [record for record in records if record["method"] == method]
        right = sum(_is_clipping_told_right(record) for record in members)
        for name in _SUMMARIES:
            cells = [_summarised(score, members, name) for score in (*SCORES, *COSTS)]
            rows.append([f"{method}: {name}", *cells, f"{right}/{len(members)}"])
    return rows


def _summarised(score: Score, members: Sequence[Record], name: str) -> str:
    """The median and its interval, what nine in ten are no worse than, or the worst."""
    values = [found for r in members if (found := value(score, r)) is not None]
    if not values:
        return "-"
    if name == "median":
        figure = estimate(values, quantile(0.5))
        assert figure is not None
        return figure.text(score.digits)
    if name == "worst":
        return score.text(max(values, key=score.badness))
    return score.text(worst_tenth(values, score.badness))


def _against_each(records: Sequence[Record]) -> list[Table]:
    """Ours less every other method, capture by capture and seed by seed; none without both."""
    ours = {(r["capture"], r["seed"]): r for r in records if r["method"] == OURS}
    rows = []
    for method in dict.fromkeys(r["method"] for r in records if r["method"] != OURS):
        others = [r for r in records if r["method"] == method and (r["capture"], r["seed"]) in ours]
        cells = []
        for score in (ALBEDO, RAW_ALBEDO):
            pairs = [(value(score, ours[r["capture"], r["seed"]]), value(score, r)) for r in others]
            gains = [mine - its for mine, its in pairs if mine is not None and its is not None]
            figure = estimate(gains, mean)
            if figure is not None:
                ahead = sum(gain > 0 for gain in gains)
                cells += [figure.text(1), f"{ahead} of {len(gains)}"]
        rows += [[method, *cells]] if cells else []
    head = ["method"]
    for score in (ALBEDO, RAW_ALBEDO):
        head += [score.title, "ahead on"]
    title = "Ours less each, mean over captures"
    return [Table(title=title, head=head, rows=rows)] if rows else []


def _is_clipping_told_right(record: Record) -> bool:
    """Whether a curve that clips is told from one that rolls off."""
    tone = record["scores"]["tone_curve"]
    return (tone["family"] == _CLIPPING) == (tone["true_view_transform"].lower() == _CLIPPING)
