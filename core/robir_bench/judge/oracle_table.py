# SPDX-License-Identifier: Apache-2.0
"""Runs with one quantity told, and what each brings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from robir.errors import UsageError
from robir_bench.ablation import gains
from robir_bench.distribution import estimate, mean, quantile
from robir_bench.judge.oracles import ORACLES, settings_of
from robir_bench.plan import OURS, BenchRun
from robir_bench.table import Record, Table, split
from robir_bench.truth.scores import ALBEDO, RAW_ALBEDO, RELIT, RERENDER, Score

Classes = Mapping[str, Mapping[str, str]]

FIGURES = (ALBEDO, RAW_ALBEDO, RERENDER, RELIT)  # by which an error's cost is told


def method_of(name: str) -> str:
    """Name of the runs with a quantity told."""
    return f"told {name}"


def told_runs(runs: Sequence[BenchRun], names: Sequence[str]) -> list[BenchRun]:
    """After each run the same with each of some quantities told; all of them where none is named.

    Raises:
        UsageError: If there is no such quantity.
    """
    if unknown := sorted(set(names) - set(ORACLES)):
        raise UsageError(
            f"--oracle: nothing is called {unknown[0]}; there are {', '.join(ORACLES)}"
        )
    return [
        one
        for run in runs
        for one in (
            run,
            *(
                replace(
                    run,
                    method=method_of(name),
                    settings=(*run.settings, *settings_of(name, run.capture)),
                    oracle=name,
                )
                for name in names or ORACLES
            ),
        )
    ]


def oracle_table(records: Sequence[Record], classes: Classes) -> Table:
    """A row a quantity: the gain of each figure, its mean with an interval, and its median."""
    done, _failed = split(records)
    whole = {record["capture"]: record for record in done if record["method"] == OURS}
    rows = []
    for name in ORACLES:
        pairs = [
            (record, whole[record["capture"]])
            for record in done
            if record["method"] == method_of(name) and record["capture"] in whole
        ]
        if pairs:
            rows.append(
                [name, str(len(pairs)), *(_cell(score, pairs, classes) for score in FIGURES)]
            )
    return Table(
        title="What each error costs: gained where one quantity is taken from the truth",
        head=["told", "captures", *(score.title for score in FIGURES)],
        rows=rows,
    )


def _cell(score: Score, pairs: Sequence[tuple[Record, Record]], classes: Classes) -> str:
    values = gains(score, pairs, classes)
    found, middle = estimate(values, mean), estimate(values, quantile(0.5))
    if found is None or middle is None:
        return "-"
    return f"{found.text(2)}, median {middle.value:.2f}"
