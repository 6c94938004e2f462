# SPDX-License-Identifier: Apache-2.0
"""The commands `robir bench` and `robir stability`; heavy imports happen where they are used."""

from __future__ import annotations

import argparse
import sys
from argparse import Namespace
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from robir.cli import path_argument
from robir.errors import UsageError

if TYPE_CHECKING:
    from robir_bench.plan import BenchRun


def add_to(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add both to the parsers of `robir`."""
    _add_bench(subparsers)
    _add_stability(subparsers)


def _add_bench(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    parser = subparsers.add_parser(
        "bench", help="run captures x methods and chart speed against accuracy"
    )
    parser.set_defaults(command=bench)
    parser.add_argument(
        "plan",
        type=path_argument,
        nargs="?",
        metavar="PLAN.toml",
        help="captures, methods and seeds",
    )
    parser.add_argument(
        "--population",
        type=path_argument,
        metavar="DIR",
        help="instead of a plan: all captures that `python -m blender_scenes population` made, and "
        "the distribution of their scores",
    )
    parser.add_argument(
        "--ablate",
        action="store_true",
        help="run a population also without each step that can be left out, and say what each is "
        "worth",
    )
    _add_runs(parser)


def _add_stability(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    parser = subparsers.add_parser(
        "stability", help="spoil captures one factor at a time and chart what that costs"
    )
    parser.set_defaults(command=stability)
    parser.add_argument(
        "plan", type=path_argument, metavar="PLAN.toml", help="as for bench, with a table [factors]"
    )
    _add_runs(parser)


def _add_runs(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "-o", "--out", type=path_argument, required=True, help="folder of runs and scores"
    )
    parser.add_argument(
        "--budget",
        type=float,
        metavar="S",
        help="CPU seconds after which no further run starts; 0 only draws what is done",
    )


def bench(options: Namespace) -> int:
    """Run a plan or a population, chart and tabulate its scores; prints the page's path.

    Of a plan the exit code is the largest of its runs'; of a population, where failures are counted
    among the scores, only a bug is a failure.
    """
    from robir_bench.page import write_ablation, write_bench, write_population
    from robir_bench.plan import read_plan
    from robir_bench.population import read_population

    if (options.plan is None) == (options.population is None):
        raise UsageError("give either PLAN.toml or --population DIR")
    if options.ablate and options.population is None:
        raise UsageError("--ablate needs --population DIR")
    if options.population is not None:
        runs, write = read_population(options.population), write_population
        if options.ablate:
            from robir_bench.ablation import ablated

            runs, write = ablated(runs), write_ablation
        tried = _carried_out(runs, write, options, is_truth_needed=True)
        return 1 if 1 in tried else 0
    return max(_carried_out(read_plan(options.plan), write_bench, options, is_truth_needed=False))


def stability(options: Namespace) -> int:
    """Run a plan on captures spoilt one factor at a time; prints the page's path.

    A spoilt capture may well be refused; only a bug is a failure of the sweep.
    """
    from robir_bench.page import write_stability
    from robir_bench.plan import read_sweep

    runs = read_sweep(options.plan, options.out)
    tried = _carried_out(runs, write_stability, options, is_truth_needed=True)
    return 1 if 1 in tried else 0


def _carried_out(
    runs: list[BenchRun], write: Callable[..., Path], options: Namespace, *, is_truth_needed: bool
) -> set[int]:
    """Do the runs and write their page; the exit codes of those that were tried."""
    from robir_bench.runs import carry_out, read_scores

    def say(line: str) -> None:
        print(line, file=sys.stderr, flush=True)

    carry_out(runs, options.out, options.budget, say, is_truth_needed=is_truth_needed)
    records = read_scores(options.out)
    print(write(options.out, runs, records).resolve())
    tried = [records[run.name] for run in runs if run.name in records]
    return {0, *(record["exit_code"] for record in tried if "error" in record)}
