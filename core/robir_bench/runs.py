# SPDX-License-Identifier: Apache-2.0
"""Carries out the runs of a bench, one after another, and records their scores."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from statistics import mean
from typing import Any

from robir.batch.local import worker_environment
from robir.config import RunConfig, resolve
from robir.errors import QualityError, RobirError
from robir.jobs.paths import STAGES, JobPaths, read_json, replacing, write_json
from robir.pipeline.device import Usage
from robir_bench.judge.oracles import is_set_after_step, mesh_of
from robir_bench.paper.config import VARIANTS, shrunken
from robir_bench.plan import BORROWERS, MITSUBA_TOLD, OURS, PHOTO, BenchRun
from robir_bench.truth.evaluate import second_light
from robir_bench.truth.files import has_truth

Record = dict[str, Any]

# Cycles samples a pixel of relit pictures, denoised; as many as the truth about has
RELIT_SAMPLES = "32"

# stages that the methods of BORROWERS share with the whole method and are charged for
_BORROWED = ("capture", "geometry")


def scores_file(folder: Path) -> Path:
    """One JSON line a run."""
    return folder / "scores.jsonl"


def result_folder(run: BenchRun, folder: Path) -> Path:
    """Where a run's result lies."""
    return folder / "runs" / run.name


def picture_file(run: BenchRun, folder: Path) -> Path:
    """The pictures of a run beside the truth; see `robir_bench.pictures`."""
    return folder / "pictures" / f"{run.name}.png"


def read_scores(folder: Path) -> dict[str, Record]:
    """Record of each run that was tried, by name; also of those that are not gathered yet."""
    loose = []
    for file in sorted(_loose(folder).glob("*.json")):
        with suppress(FileNotFoundError):  # gathered meanwhile, so that it is in the other file now
            loose.append(read_json(file))
    return {record["name"]: record for record in [*_gathered(folder), *loose]}


def _gathered(folder: Path) -> list[Record]:
    file = scores_file(folder)
    lines = file.read_text(encoding="utf-8").splitlines() if file.exists() else []
    return [json.loads(line) for line in lines]


def _loose(folder: Path) -> Path:
    """Where a task of a bench leaves its record, as it may not be the only one at work."""
    return folder / "records"


class Scores:
    """The records of a folder and their file: what was there, then the rest in the plan's order."""

    def __init__(self, folder: Path, runs: Sequence[BenchRun]) -> None:
        """Gather what tasks have left."""
        self._folder, self._runs = folder, runs
        loose = list(_loose(folder).glob("*.json"))
        before = [record["name"] for record in _gathered(folder)]
        self.records = read_scores(folder)
        self._order = dict.fromkeys([*before, *(run.name for run in runs), *self.records])
        if loose:
            self._write()
            for file in loose:
                file.unlink(missing_ok=True)

    def has(self, run: BenchRun) -> bool:
        """Whether a run was done; one that failed was not."""
        return "scores" in self.records.get(run.name, {})

    @property
    def missing(self) -> list[int]:
        """Numbers of the runs that are not done."""
        return [number for number, run in enumerate(self._runs) if not self.has(run)]

    def keep(self, record: Record) -> None:
        """Write a record down."""
        self.records[record["name"]] = record
        self._write()
        (_loose(self._folder) / f"{record['name']}.json").unlink(missing_ok=True)

    def _write(self) -> None:
        with replacing(scores_file(self._folder)) as temporary:
            known = (self.records[name] for name in self._order if name in self.records)
            lines = (json.dumps(record) + "\n" for record in known)
            temporary.write_text("".join(lines), encoding="utf-8")


def do_task(run: BenchRun, folder: Path, *, is_truth_needed: bool) -> None:
    """Do one run if it is not done, and leave its record for whoever gathers them.

    Args:
        run: What to do; those that it borrows stages from have ended.
        folder: Of the results.
        is_truth_needed: Whether a capture without truth counts as failed.
    """
    records = read_scores(folder)
    if "scores" not in records.get(run.name, {}):
        record = _done(run, folder, records, is_truth_needed)
        write_json(_loose(folder) / f"{run.name}.json", record)


def carry_out(
    runs: Sequence[BenchRun],
    folder: Path,
    budget: float | None,
    say: Callable[[str], None],
    *,
    is_truth_needed: bool = False,
) -> None:
    """Do every run that has no score yet; one that fails is recorded and stops nothing.

    Args:
        runs: What to do, in order.
        folder: Of the results and `scores.jsonl`.
        budget: CPU seconds that this call may take, or None. A run that would probably exceed
            it, by the mean of those before, is left for the next call.
        say: Takes a line about each run.
        is_truth_needed: Whether a capture without truth counts as failed.
    """
    scores = Scores(folder, runs)
    begin, spent = Usage.now(), []
    for number, run in enumerate(runs, 1):
        if scores.has(run):
            say(f"{number}/{len(runs)} {run.name}: done before")
            continue
        used = Usage.now().seconds_since(begin)["cpu"]
        if budget is not None and used + (mean(spent) if spent else 0.0) >= budget:
            say(out_of_budget(used, budget, scores))
            return
        record = _done(run, folder, scores.records, is_truth_needed)
        spent.append(Usage.now().seconds_since(begin)["cpu"] - used)
        scores.keep(record)
        say(f"{number}/{len(runs)} {run.name}: {record.get('error', 'done')}")


def out_of_budget(used: float, budget: float, scores: Scores) -> str:
    """What is said where no further run starts."""
    left = len(scores.missing)
    return f"{used:.0f} CPU-s of {budget:.0f} are spent; {left} runs are left for next time"


def waits_for(runs: Sequence[BenchRun]) -> list[set[int]]:
    """Numbers of the runs that have to end before each run, all of them earlier in the plan.

    Those are the ones it borrows stages from, and the first that makes the same spoilt capture.
    """
    numbers = {run.name: number for number, run in enumerate(runs)}
    makers: dict[Path, int] = {}
    waits = []
    for number, run in enumerate(runs):
        lenders = (replace(run, method=method).name for method in _loans(run.method))
        found = {numbers.get(name, number) for name in lenders}
        if run.perturbation is not None:
            found.add(makers.setdefault(run.capture, number))
        waits.append({other for other in found if other < number})
    return waits


def _done(
    run: BenchRun, folder: Path, records: Mapping[str, Record], is_truth_needed: bool
) -> Record:
    """The record of a run, which is done for it unless that is known without."""
    whole = records.get(replace(run, method=OURS).name, {})
    return _same(run, folder, whole) or _record(run, folder, is_truth_needed)


def _same(run: BenchRun, folder: Path, whole: Record) -> Record | None:
    """The record of a run without a step that changed nothing in the whole run, else None."""
    if run.left_out is None or "scores" not in whole:
        return None
    stage, step = run.left_out
    told = JobPaths(result_folder(replace(run, method=OURS), folder)).steps(stage)
    if not told.exists() or step not in read_json(told)["idle"]:
        return None
    return whole | run.facts


def _record(run: BenchRun, folder: Path, is_truth_needed: bool) -> Record:
    out = result_folder(run, folder)
    try:
        if run.perturbation is not None:
            run.perturbation.make(run.capture, run.seed)
        _borrow_stages(run, folder, out)
        held_out = _made(run, out)
        _relight(run, out)
    except RobirError as error:
        return run.facts | {"error": str(error), "exit_code": error.exit_code}
    truth = ["--truth", str(run.capture)] if is_truth_needed or has_truth(run.capture) else []
    judged = _robir("evaluate", str(out), *truth, "--json")
    if judged.returncode != 0:
        return run.facts | {"error": last_line(judged.stderr), "exit_code": judged.returncode}
    scores = json.loads(judged.stdout)
    _draw(run, folder, scores)
    about = read_json(JobPaths(out).run)
    report = JobPaths(out).report_json
    told = read_json(report).get("trust") if report.exists() else None
    return run.facts | {
        "seconds": about["seconds"],
        "cpu_seconds": sum(stage["cpu"] for stage in about["seconds"].values()),
        "step_seconds": {
            stage: read_json(steps)["cpu_seconds"]
            for stage in about["seconds"]
            if (steps := JobPaths(out).steps(stage)).exists()
        },
        "peak_gigabytes": max(about["peak_memory_bytes"].values()) / 1e9,
        "warnings": [warning["message"] for warning in about.get("warnings", [])],
        "trust": told,
        "held_out": held_out,
        "scores": scores,
    }


class _RunError(RobirError):
    """A run ended without a result."""

    def __init__(self, message: str, exit_code: int) -> None:
        super().__init__(message)
        self.exit_code = exit_code


def _made(run: BenchRun, out: Path) -> Record:
    """Bring a result about; scores of its re-rendered held-out views."""
    if run.method in VARIANTS:
        return _published(run, out)
    return _textured(run, out) if run.method in BORROWERS else _reconstructed(run, out)


def _reconstructed(run: BenchRun, out: Path) -> Record:
    """Run the pipeline; scores of its re-rendered held-out views."""
    changes = [word for setting in run.settings for word in ("--set", setting)]
    words = ["--seed", str(run.seed), "--resume", "--defaults", "--progress", "plain"]
    if run.oracle is not None and (mesh := mesh_of(run.oracle, run.capture)) is not None:
        words += ["--mesh", str(mesh)]
    where = (str(run.capture), str(out))
    if run.oracle is not None and is_set_after_step(run.oracle):
        fitted = _python("robir_bench.judge.oracles", run.oracle, *where, *words, *changes)
    else:
        fitted = _robir("reconstruct", where[0], "-o", where[1], *words, *changes)
    is_doubtful = fitted.returncode == QualityError.exit_code
    # a result that failed its own quality check is whole, which a fit that broke off is not
    if fitted.returncode != 0 and not (is_doubtful and _is_whole(JobPaths(out))):
        raise _RunError(last_line(fitted.stderr), fitted.returncode)
    return read_json(JobPaths(out).report_json)["held_out"]


def _relight(run: BenchRun, out: Path) -> None:
    """Show a result under the second light that its capture has the truth of, if it has one.

    Methods that borrow our stages, and those of others, leave no asset that could be shown.
    """
    has_asset = run.method not in VARIANTS and run.method not in BORROWERS
    light = second_light(run.capture) if run.is_relit and has_asset else None
    if light is not None:
        command = ("relight", str(out), "--environment", str(light), "--samples", RELIT_SAMPLES)
        relit = _robir(*command, "--progress", "plain")
        if relit.returncode != 0:
            raise _RunError(last_line(relit.stderr), relit.returncode)


def _is_whole(paths: JobPaths) -> bool:
    return paths.run.exists() and read_json(paths.run).get("state") == "done"


def _textured(run: BenchRun, out: Path) -> Record:
    """Texture the borrowed surface in another way; scores of its held-out views."""
    paths = JobPaths(out)
    missing = [stage for stage in _BORROWED if not paths.manifest(stage).exists()]
    if missing:
        raise _RunError(f"the whole method left no {missing[0]} to start from", 1)
    before, about = Usage.now(), read_json(paths.run)
    if run.method == PHOTO:
        from robir_bench.peers.photo import texture_photographs

        scores = texture_photographs(paths, resolve(RunConfig(), None, run.settings))
    else:
        from robir_bench.peers.prb import traced_appearance

        truth = run.capture if run.method == MITSUBA_TOLD else None
        made = traced_appearance(paths, run.seed, truth)
        scores = made["held_out"]
        about["peak_memory_bytes"] |= {"appearance": made["peak_memory_bytes"]}
    for entry in ("seconds", "peak_memory_bytes"):
        kept = (*_BORROWED, "appearance")
        about[entry] = {name: value for name, value in about[entry].items() if name in kept}
    about["seconds"]["appearance"] = Usage.now().seconds_since(before)
    about["warnings"] = []
    for stage in STAGES[STAGES.index("appearance") :]:
        write_json(paths.manifest(stage), {"stage": stage, "method": run.method})
    write_json(paths.run, about)
    return scores


def _published(run: BenchRun, out: Path) -> Record:
    """What is not borrowed of a published method; scores of its held-out views."""
    from robir_bench.paper.method import reconstruct_published

    paths = JobPaths(out)
    if not paths.manifest("capture").exists():
        raise _RunError("the whole method left no capture to start from", 1)
    settings = (*run.settings, f"seed={run.seed}")
    config = resolve(RunConfig(), None, settings)
    return reconstruct_published(paths, config, run.method, shrunken())


def _draw(run: BenchRun, folder: Path, scores: Record) -> None:
    """Keep a picture for the page; a result that cannot be drawn still has its scores."""
    from robir_bench.pictures import draw_photographed, draw_result

    picture = picture_file(run, folder)
    if "albedo" not in scores:
        draw_photographed(JobPaths(result_folder(run, folder)), picture)
        return
    scale = scores["albedo"]["scale"]["per_channel_lsq"]
    draw_result(JobPaths(result_folder(run, folder)), run.capture, scale, picture)


def _loans(method: str) -> dict[str, tuple[str, ...]]:
    """Which stages a method takes from which others, if they have them."""
    if method in BORROWERS:
        return {OURS: (*_BORROWED, "transport")}
    if method.startswith("told "):
        return {OURS: (*_BORROWED, "transport")}
    if method not in VARIANTS:
        return {OURS: STAGES[:-1]}
    loans: dict[str, tuple[str, ...]] = {OURS: ("capture",)}
    for other, variant in VARIANTS.items():
        # Indirect light is learnt under the tone curve; all before it knows none.
        is_alike = variant.has_aces == VARIANTS[method].has_aces
        loans[other] = ("geometry", "transport") if is_alike else ("geometry",)
    return loans


def _borrow_stages(run: BenchRun, folder: Path, out: Path) -> None:
    """Start a method from folders of others: what it shares is then done before.

    The borrowed stages keep their seconds, so every method is charged for all it needs.
    """
    whole = JobPaths(result_folder(replace(run, method=OURS), folder))
    if run.method == OURS or out.exists() or not whole.run.exists():
        return
    part = JobPaths(out.with_name(f".{out.name}"))
    shutil.rmtree(part.root, ignore_errors=True)
    about = read_json(whole.run)
    if run.method in VARIANTS:
        about |= {"seconds": {}, "peak_memory_bytes": {}, "warnings": []}
    for method, stages in _loans(run.method).items():
        lender = JobPaths(result_folder(replace(run, method=method), folder))
        for stage in stages:
            if lender.manifest(stage).exists() and not part.manifest(stage).exists():
                shutil.copytree(lender.stage(stage), part.stage(stage))
                lent = read_json(lender.run)
                for cost in ("seconds", "peak_memory_bytes"):
                    if stage in lent[cost]:
                        about[cost][stage] = lent[cost][stage]
    write_json(part.run, about)
    shutil.copy(whole.config, part.config)
    part.root.replace(out)


def _robir(*words: str) -> subprocess.CompletedProcess[str]:
    return _python("robir", *words)


def _python(module: str, *words: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", module, *words]
    environment = worker_environment()  # so that scores do not depend on where and beside what
    return subprocess.run(command, capture_output=True, text=True, check=False, env=environment)


def last_line(text: str) -> str:
    """What a program said last."""
    lines = text.strip().splitlines()
    return lines[-1] if lines else "ended without a message"
