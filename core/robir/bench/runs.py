# SPDX-License-Identifier: Apache-2.0
"""Carries out the runs of a bench, each in a process of its own, and records their scores."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from robir.bench.plan import BenchRun
from robir.jobs.paths import STAGES, JobPaths, read_json, replacing


def scores_file(folder: Path) -> Path:
    """One JSON line a run."""
    return folder / "scores.jsonl"


def read_scores(folder: Path) -> dict[str, dict[str, Any]]:
    """Record of each run that was tried, by name."""
    file = scores_file(folder)
    lines = file.read_text(encoding="utf-8").splitlines() if file.exists() else []
    return {record["name"]: record for record in map(json.loads, lines)}


def carry_out(runs: Sequence[BenchRun], folder: Path, say: Callable[[str], None]) -> None:
    """Do every run that has no score yet; one that fails is recorded and stops nothing.

    Args:
        runs: What to do, in order.
        folder: Of the results and `scores.jsonl`.
        say: Takes a line about each run.
    """
    records = read_scores(folder)
    for number, run in enumerate(runs, 1):
        if "scores" in records.get(run.name, {}):
            say(f"{number}/{len(runs)} {run.name}: done before")
            continue
        records[run.name] = _record(run, folder)
        with replacing(scores_file(folder)) as temporary:
            lines = (json.dumps(record) + "\n" for record in records.values())
            temporary.write_text("".join(lines), encoding="utf-8")
        say(f"{number}/{len(runs)} {run.name}: {records[run.name].get('error', 'done')}")


def _record(run: BenchRun, folder: Path) -> dict[str, Any]:
    out = folder / "runs" / run.name
    facts = {
        "name": run.name,
        "capture": run.capture.name,
        "preset": run.preset,
        "variant": run.variant,
        "seed": run.seed,
    }
    _borrow_stages(run, folder, out)
    changes = [word for setting in run.settings for word in ("--set", setting)]
    fitted = _robir(
        "reconstruct", str(run.capture), "-o", str(out), "--preset", run.preset,
        "--seed", str(run.seed), "--resume", "--progress", "plain", *changes,
    )  # fmt: skip
    if fitted.returncode != 0:
        return facts | {"error": _last_line(fitted.stderr)}
    judged = _robir("evaluate", str(out), "--truth", str(run.capture), "--json")
    if judged.returncode != 0:
        return facts | {"error": _last_line(judged.stderr)}
    about = read_json(JobPaths(out).run)
    return facts | {
        "seconds": about["seconds"],
        "cpu_seconds": sum(stage["cpu"] for stage in about["seconds"].values()),
        "peak_gigabytes": max(about["peak_memory_bytes"].values()) / 1e9,
        "scores": json.loads(judged.stdout),
    }


def _borrow_stages(run: BenchRun, folder: Path, out: Path) -> None:
    """Start an ablation from the whole method's folder: what it shares is then done before."""
    whole = JobPaths(folder / "runs" / replace(run, variant="full").name)
    if out.exists() or not whole.run.exists():
        return
    part = JobPaths(out.with_name(f".{out.name}"))
    shutil.rmtree(part.root, ignore_errors=True)
    for stage in STAGES[:-1]:
        if whole.manifest(stage).exists():
            shutil.copytree(whole.stage(stage), part.stage(stage))
    shutil.copy(whole.config, part.config)
    shutil.copy(whole.run, part.run)
    part.root.replace(out)


def _robir(*words: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "robir", *words]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def _last_line(text: str) -> str:
    lines = text.strip().splitlines()
    return lines[-1] if lines else "ended without a message"
