# SPDX-License-Identifier: Apache-2.0
"""The commands `robir bench` and `robir stability`, and the option `robir evaluate --truth`.

Heavy imports happen where they are used.
"""

from __future__ import annotations

import argparse
import sys
from argparse import Namespace
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from robir.arguments import add_constant, path_argument, positive
from robir.errors import UsageError
from robir.jobs.paths import JobPaths, write_json

if TYPE_CHECKING:
    from robir_bench.plan import BenchRun


def add_to(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add them to the parsers of `robir`."""
    _add_bench(subparsers)
    _add_stability(subparsers)
    evaluate = subparsers.choices["evaluate"]
    evaluate.set_defaults(compare=compared_with_truth)
    evaluate.add_argument(
        "--truth",
        type=path_argument,
        metavar="CAPTURE",
        help="the rendered capture it was made from",
    )


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
        nargs="*",
        metavar="STAGE.STEP",
        help="run a population also without each step that can be left out, or without each of "
        "those named, and say what each is worth",
    )
    parser.add_argument(
        "--oracle",
        nargs="*",
        metavar="NAME",
        help="run a population also with each quantity taken from the truth, or with each of those "
        "named, and say what each error costs",
    )
    parser.add_argument(
        "--keep",
        type=path_argument,
        metavar="FILE",
        help="write the figures of a population to a small file that outlives its captures",
    )
    parser.add_argument(
        "--compare",
        type=path_argument,
        nargs=2,
        metavar=("BEFORE", "AFTER"),
        help="compare two such files capture by capture, and do nothing else",
    )
    _add_runs(parser, is_out_needed=False)


def _add_stability(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    parser = subparsers.add_parser(
        "stability", help="spoil captures one factor at a time and chart what that costs"
    )
    parser.set_defaults(command=stability, population=None, ablate=None, oracle=None, keep=None)
    parser.add_argument(
        "plan", type=path_argument, metavar="PLAN.toml", help="as for bench, with a table [factors]"
    )
    _add_runs(parser, is_out_needed=True)


def _add_runs(parser: argparse.ArgumentParser, *, is_out_needed: bool) -> None:
    parser.add_argument(
        "-o", "--out", type=path_argument, required=is_out_needed, help="folder of runs and scores"
    )
    parser.add_argument(
        "--budget",
        type=float,
        metavar="S",
        help="CPU seconds after which no further run starts; 0 only draws what is done",
    )
    parser.add_argument(
        "--on",
        choices=("local", "openjd", "slurm"),
        default="local",
        help="who works: this machine (default), a render farm by an Open Job Description bundle, "
        "or Slurm",
    )
    parser.add_argument(
        "--jobs",
        type=positive,
        default=1,
        help="most runs at a time on this machine, default 1; one that starts from stages of "
        "another waits for that",
    )
    parser.add_argument("--task", type=int, metavar="N", help="only run N of the plan, for farms")
    add_constant(parser)


def compared_with_truth(paths: JobPaths, truth: Path) -> tuple[dict[str, Any], list[str]]:
    """Scores of a result against the truth, written beside the report, and lines of them."""
    from robir_bench.truth.evaluate import evaluate
    from robir_bench.truth.scores import score_lines

    scores = evaluate(paths, truth, paths.truth_sheet)
    write_json(paths.scores, scores)
    return scores, score_lines(scores)


def bench(options: Namespace) -> int:
    """Run a plan or a population, chart and tabulate its scores; prints the page's path.

    Of a plan the exit code is the largest of its runs'; of a population, where failures are counted
    among the scores, only a bug is a failure.
    """
    from robir_bench.plan import read_plan, with_constants
    from robir_bench.population import read_population

    if options.compare is not None:
        from robir_bench.judge.scores import compared

        print(compared(*options.compare).markdown())
        return 0
    if (options.plan is None) == (options.population is None) or options.out is None:
        raise UsageError("give -o OUT and either PLAN.toml or --population DIR")
    is_ablation, is_oracle = options.ablate is not None, options.oracle is not None
    if (is_ablation or is_oracle or options.keep) and options.population is None:
        raise UsageError("--ablate, --oracle and --keep need --population DIR")
    is_population = options.population is not None
    runs = read_population(options.population) if is_population else read_plan(options.plan)
    runs = with_constants(runs, options.constants)
    if is_ablation:
        from robir_bench.ablation import ablated, chosen_trials

        runs = ablated(runs, chosen_trials(options.ablate))
    elif is_oracle:
        from robir_bench.judge.oracle_table import told_runs

        runs = told_runs(runs, options.oracle)
    if _is_farmed(runs, options, is_truth_needed=is_population):
        return 0
    from robir_bench.page import write_ablation, write_bench, write_oracles, write_population

    write = write_population if is_population else write_bench
    write = write_ablation if is_ablation else write_oracles if is_oracle else write
    tried = _carried_out(runs, write, options, is_truth_needed=is_population)
    return int(1 in tried) if is_population else max(tried)


def stability(options: Namespace) -> int:
    """Run a plan on captures spoilt one factor at a time; prints the page's path.

    A spoilt capture may well be refused; only a bug is a failure of the sweep.
    """
    from robir_bench.plan import read_sweep, with_constants

    runs = with_constants(read_sweep(options.plan, options.out), options.constants)
    if _is_farmed(runs, options, is_truth_needed=True):
        return 0
    from robir_bench.page import write_stability

    return int(1 in _carried_out(runs, write_stability, options, is_truth_needed=True))


def _is_farmed(runs: list[BenchRun], options: Namespace, *, is_truth_needed: bool) -> bool:
    """Do the one run of a task, or give what is missing to a farm and print where that is.

    Returns:
        False where neither is asked for.
    """
    if options.task is not None:
        from robir_bench.runs import do_task

        if not 0 <= options.task < len(runs):
            raise UsageError(f"there are {len(runs)} runs, counted from 0")
        do_task(runs[options.task], options.out, is_truth_needed=is_truth_needed)
        return True
    if options.on == "local":
        return False
    from robir.batch.farm import submit_to_slurm, write_openjd
    from robir_bench.tasks import bench_job

    if options.budget is not None:
        raise UsageError("--budget is for this machine; Slurm has SBATCH_TIMELIMIT")
    job = bench_job(runs, options.out, options.population or options.plan, options)
    if job is None:
        print("nothing is missing; draw it with --budget 0", file=sys.stderr)
    elif options.on == "openjd":
        print(write_openjd(job, options.out / "openjd").resolve())
    else:
        print("\n".join(submit_to_slurm(job, options.out / "records")))
    return True


def _carried_out(
    runs: list[BenchRun], write: Callable[..., Path], options: Namespace, *, is_truth_needed: bool
) -> set[int]:
    """Do the runs and write their page; the exit codes of those that were tried."""
    from robir_bench.crew import Crew
    from robir_bench.runs import carry_out, read_scores
    from robir_bench.tasks import words_of

    def say(line: str) -> None:
        print(line, file=sys.stderr, flush=True)

    if options.jobs > 1:
        words = words_of(options, str(options.population or options.plan), str(options.out))
        command = [sys.executable, "-P", "-m", "robir", *words, "--task"]
        crew = Crew(runs=runs, folder=options.out, jobs=options.jobs, command=command, say=say)
        crew.work(options.budget)
    else:
        carry_out(runs, options.out, options.budget, say, is_truth_needed=is_truth_needed)
    records = read_scores(options.out)
    print(write(options.out, runs, records).resolve())
    if options.keep:
        from robir_bench.judge.scores import keep
        from robir_bench.plan import OURS
        from robir_bench.population import capture_classes

        whole = [records[run.name] for run in runs if run.name in records and run.method == OURS]
        keep(options.keep, options.keep.stem, whole, capture_classes(runs))
    tried = [records[run.name] for run in runs if run.name in records]
    return {0, *(record["exit_code"] for record in tried if "error" in record)}
