# SPDX-License-Identifier: Apache-2.0
"""A bench as a job for a farm: a task a run, in steps, so that lenders of stages come first."""

from __future__ import annotations

import os
from argparse import Namespace
from collections.abc import Iterator, Sequence
from pathlib import Path

from robir.batch.farm import FarmJob, FarmStep, Place
from robir.batch.local import memory_needed
from robir.batch.plan import Entry, Plan
from robir_bench.plan import BenchRun
from robir_bench.runs import Scores, waits_for


def bench_job(
    runs: Sequence[BenchRun], out: Path, source: Path, options: Namespace
) -> FarmJob | None:
    """The runs that are not done yet, and the page after all; None where nothing is missing.

    Args:
        runs: Of the plan, in order.
        out: Folder of runs and scores.
        source: The plan or the folder of a population.
        options: As parsed.
    """
    missing = Scores(out, runs).missing
    if not missing:
        return None
    source, out = source.resolve(), out.resolve()
    captures = {path for number in missing for path in _captures(runs[number], out)}
    folders = [source if source.is_dir() else source.parent, *(path.parent for path in captures)]
    root = Path(os.path.commonpath(folders))
    where = "/".join(("{{Param.Source}}", *source.relative_to(root).parts))
    words = tuple(words_of(options, where, "{{Param.Out}}"))
    steps: list[FarmStep] = []
    for number, wave in enumerate(_waves(runs, missing), 1):
        step = FarmStep(
            name=f"Runs{number}",
            words=words,
            tasks=tuple(wave),
            after=steps[-1].name if steps else "",
            memory=max(_need(runs[task], out) for task in wave),
        )
        steps.append(step)
    steps.append(FarmStep(name="Page", words=(*words, "--budget", "0"), after=steps[-1].name))
    return FarmJob(
        name=f"RobIR {options.command.__name__} {out.name}",
        places={
            "Out": Place(path=out, flow="INOUT", about="Runs, scores and their page"),
            "Source": Place(path=root, flow="IN", about="Folder that holds plan and captures"),
        },
        steps=steps,
    )


def words_of(options: Namespace, source: str, out: str) -> list[str]:
    """The command line after `robir` that does the same.

    Args:
        options: As parsed.
        source: The plan or the population.
        out: Folder of runs and scores.
    """
    words = ["--population", source] if options.population is not None else [source]
    ablate = [] if options.ablate is None else ["--ablate", *options.ablate]
    told = [] if options.oracle is None else ["--oracle", *options.oracle]
    constants = [word for change in options.constants for word in ("--constant", change)]
    return [options.command.__name__, *words, *ablate, *told, *constants, "-o", out]


def _waves(runs: Sequence[BenchRun], missing: Sequence[int]) -> list[list[int]]:
    """What is missing in groups, each of which needs none but those before it."""
    waits, level = waits_for(runs), dict[int, int]()
    for number in missing:
        level[number] = 1 + max((level[n] for n in waits[number] if n in level), default=-1)
    return [[n for n in missing if level[n] == wave] for wave in range(1 + max(level.values()))]


def _captures(run: BenchRun, out: Path) -> Iterator[Path]:
    """What a run reads that is not made by it."""
    if run.perturbation is not None:
        yield run.perturbation.source
    if not run.capture.is_relative_to(out):
        yield run.capture


def _need(run: BenchRun, out: Path) -> int:
    """Bytes of memory."""
    *_, capture = _captures(run, out)
    entry = Entry(path=capture.name, settings=run.settings)
    return memory_needed(Plan(captures=capture.parent, entries=(entry,)), entry)
