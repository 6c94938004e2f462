# SPDX-License-Identifier: Apache-2.0
"""Hands a job to schedulers that exist: as an Open Job Description bundle, or to Slurm.

A job is steps of `robir` commands, most of them one task a number. What was done before a task
leaves alone, so whatever a scheduler ends may simply be started again. A library is
one task a capture, or one for each part of its stages.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from robir.batch.local import worker_environment
from robir.errors import DeviceError, UsageError
from robir.jobs.library import LibraryPaths
from robir.jobs.paths import STAGES, write_json

MOST_TASKS = 1000  # largest array that Slurm takes by default (MaxArraySize)
_MIB = 1 << 20

_SCRIPT = Path(__file__).with_name("templates") / "slurm.sh"  # fixed; all else are words


@dataclass(frozen=True, slots=True)
class Place:
    """A folder that a farm may have elsewhere."""

    path: Path  # where it is here, absolute
    flow: Literal["IN", "INOUT"]  # whether it is only read, or written, too
    about: str  # what it is, for people


@dataclass(frozen=True, slots=True, kw_only=True)
class FarmStep:
    """One command, for several numbers or once."""

    name: str  # of the step, letters only
    words: tuple[str, ...]  # of the command after `robir`; a place is spelt {{Param.NAME}}
    tasks: tuple[int, ...] = ()  # numbers, rising, given as `--task`; empty for one task without
    after: str = ""  # step that has to end before; empty for none
    is_paired: bool = False  # whether a task waits for that of its number alone, and its good end
    memory: int = 0  # bytes that a task needs
    needs_gpu: bool = False  # whether a task asks for a graphics card
    queue: str = ""  # Slurm's partition; empty for the usual one


@dataclass(frozen=True, slots=True, kw_only=True)
class FarmJob:
    """What a farm is to do."""

    name: str  # for people
    places: Mapping[str, Place]  # by name
    steps: Sequence[FarmStep]  # each after those that it waits for


def write_openjd(job: FarmJob, folder: Path) -> Path:
    """Write a job bundle; its places are parameters, which start from its folder."""
    values = [
        {"name": name, "value": Path(os.path.relpath(place.path, folder.absolute())).as_posix()}
        for name, place in job.places.items()
    ]
    write_json(folder / "parameter_values.json", {"parameterValues": values})
    folder_kind = {"type": "PATH", "objectType": "DIRECTORY"}
    python = {"name": "Python", "type": "STRING", "default": "python3"}
    template = {
        "specificationVersion": "jobtemplate-2023-09",
        "name": job.name[:128],
        "parameterDefinitions": [
            *(
                {"name": name, "description": place.about, **folder_kind, "dataFlow": place.flow}
                for name, place in job.places.items()
            ),
            python | {"description": "Python that has robir"},
        ],
        "steps": [_step(step) for step in job.steps],
    }
    write_json(folder / "template.json", template)
    return folder


def _step(step: FarmStep) -> dict[str, Any]:
    number = ("--task", "{{Task.Param.Number}}") if step.tasks else ()
    cancel = {"mode": "NOTIFY_THEN_TERMINATE", "notifyPeriodInSeconds": 30}
    args = ["-P", "-m", "robir", *step.words, *number]
    action = {"command": "{{Param.Python}}", "args": args, "cancelation": cancel}
    table: dict[str, Any] = {"name": step.name}
    if step.after:
        table["dependencies"] = [{"dependsOn": step.after}]
    if step.tasks:
        numbers = {"name": "Number", "type": "INT", "range": ranges(step.tasks)}
        table["parameterSpace"] = {"taskParameterDefinitions": [numbers]}
        needs = [{"name": "amount.worker.vcpu", "min": 1}]
        if step.memory:
            needs.append({"name": "amount.worker.memory", "min": _mebibytes(step.memory)})
        if step.needs_gpu:
            needs.append({"name": "amount.worker.gpu", "min": 1})
        table["hostRequirements"] = {"amounts": needs}
    return table | {"script": {"actions": {"onRun": action}}}


def submit_to_slurm(job: FarmJob, logs: Path) -> list[str]:
    """Queue each step as an array of jobs, or as one; their numbers. `logs` gets what they print.

    Partition, account, time limit and the like are taken from sbatch's own variables, such as
    SBATCH_PARTITION; see `man sbatch`. submitit is not used: it hands functions over as pickles,
    which hold code. `UsageError` if there are more tasks than an array may have, `DeviceError` if
    Slurm is not there, or refuses.
    """
    if max(max(step.tasks, default=0) for step in job.steps) >= MOST_TASKS:
        raise UsageError(f"Slurm takes {MOST_TASKS} tasks at a time; split the plan")
    logs.mkdir(parents=True, exist_ok=True)
    queued: dict[str, str] = {}
    for step in job.steps:
        log = logs.absolute() / f"slurm-{step.name.lower()}-{'%A-%a' if step.tasks else '%j'}.log"
        # TERM a minute before the end: what is at work ends in good order, and goes on later
        words = [f"--output={log}", f"--job-name=robir-{step.name.lower()}", "--requeue"]
        words += ["--signal=B:TERM@60", "--cpus-per-task=1", "--kill-on-invalid-dep=yes"]
        words += ["--array", ranges(step.tasks)] if step.tasks else []
        words += [f"--mem={_mebibytes(step.memory)}M"] if step.memory else []
        words += ["--gres=gpu:1"] if step.needs_gpu else []
        words += [f"--partition={step.queue}"] if step.queue else []
        if step.after:
            kind = "aftercorr" if step.is_paired else "afterany"
            words += ["--dependency", f"{kind}:{queued[step.after]}"]
        queued[step.name] = _sbatch([*words, str(_SCRIPT), *_here(step.words, job.places)])
    return list(queued.values())


def _here(words: Sequence[str], places: Mapping[str, Place]) -> list[str]:
    """Words with the places as they are called here."""
    found = list(words)
    for name, place in places.items():
        found = [word.replace(f"{{{{Param.{name}}}}}", str(place.path)) for word in found]
    return found


def ranges(tasks: Sequence[int]) -> str:
    """Rising numbers such as "0-3,7", which both schedulers read."""
    runs: list[list[int]] = []
    for task in tasks:
        if runs and task == runs[-1][1] + 1:
            runs[-1][1] = task
        else:
            runs.append([task, task])
    return ",".join(str(a) if a == b else f"{a}-{b}" for a, b in runs)


def _mebibytes(size: int) -> int:
    return -(-size // _MIB)


def _sbatch(words: Sequence[str]) -> str:
    command = ["sbatch", "--parsable", "--export=ALL", *words]
    environment = {**worker_environment(), "ROBIR_PYTHON": sys.executable}
    try:
        done = subprocess.run(command, capture_output=True, env=environment, check=False)
    except OSError as error:
        raise DeviceError(f"sbatch cannot be run: {error.strerror}; is Slurm installed?") from error
    if done.returncode:
        said = done.stderr.decode(errors="replace").strip()
        raise DeviceError(f"Slurm takes no batch: {said}; see `man sbatch` for its variables")
    return done.stdout.decode().strip().partition(";")[0]


FIT = "geometry"  # the stage that a graphics card shortens most
_WHOLE = {"Reconstruct": (STAGES[0], STAGES[-1])}
# first and last stage of each step
_PARTS = {"Read": ("capture", "capture"), "Fit": (FIT, FIT), "Finish": ("transport", STAGES[-1])}


def library_job(
    paths: LibraryPaths, captures: Path, tasks: Sequence[int], memory: int, queue: str | None
) -> FarmJob:
    """The captures to do, by number, and the page after all; the fit alone in a `queue`, if one."""
    root = paths.root.absolute()
    common = ("batch", "--resume", "-o", "{{Param.Library}}", "--captures", "{{Param.Captures}}")
    steps: list[FarmStep] = []
    for name, (first, last) in (_WHOLE if queue is None else _PARTS).items():
        is_fit = queue is not None and first == FIT
        step = FarmStep(
            name=name,
            words=common if queue is None else (*common, "--stages", f"{first}-{last}"),
            tasks=tuple(tasks),
            after=steps[-1].name if steps else "",
            is_paired=True,
            memory=memory,
            needs_gpu=is_fit,
            queue=queue or "" if is_fit else "",
        )
        steps.append(step)
    steps.append(FarmStep(name="Page", words=(*common, "--page"), after=steps[-1].name))
    return FarmJob(
        name=f"RobIR {root.name}",
        places={
            "Library": Place(root, "INOUT", "Results, assets and the contact sheet"),
            "Captures": Place(captures, "IN", "Folder that holds all captures"),
        },
        steps=steps,
    )
