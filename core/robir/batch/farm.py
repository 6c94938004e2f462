# SPDX-License-Identifier: Apache-2.0
"""Hands a library to schedulers that exist: as an Open Job Description bundle, or to Slurm.

Both start `robir batch --resume -o LIBRARY --task N` for each capture and `--page` after all; what
was done before is left alone, so whatever a scheduler ends may simply be started again.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from robir.batch.local import worker_environment
from robir.errors import DeviceError, UsageError
from robir.jobs.library import LibraryPaths
from robir.jobs.paths import write_json

MOST_TASKS = 1000
"""Largest array that Slurm takes by default (MaxArraySize)."""

_MIB = 1 << 20

_SCRIPT = b"""#!/bin/sh
if [ -n "$SLURM_ARRAY_TASK_ID" ]; then set -- --task "$SLURM_ARRAY_TASK_ID"; else set -- --page; fi
set -- -o "$ROBIR_LIBRARY" --captures "$ROBIR_CAPTURES" "$@"
exec "$ROBIR_PYTHON" -P -m robir batch --resume "$@"
"""
"""What Slurm runs; everything particular is in its variables."""


def write_openjd(paths: LibraryPaths, captures: Path, tasks: Sequence[int], memory: int) -> Path:
    """Write the job bundle into the library.

    Its paths are parameters, so that a farm may map them; the values beside it start from the
    bundle's own folder.

    Args:
        paths: The library.
        captures: Folder that holds all captures.
        tasks: Numbers of the captures in the plan that are to be done.
        memory: Bytes that the most hungry of them needs.

    Returns:
        The bundle's folder.
    """
    folder = paths.openjd
    above = Path(os.path.relpath(captures, folder.absolute())).as_posix()
    values = [{"name": "Library", "value": ".."}, {"name": "Captures", "value": above}]
    write_json(folder / "parameter_values.json", {"parameterValues": values})
    write_json(folder / "template.json", _template(paths.root.absolute().name, tasks, memory))
    return folder


def submit_to_slurm(
    paths: LibraryPaths, captures: Path, tasks: Sequence[int], memory: int
) -> tuple[str, str]:
    """Queue an array of one task a capture, and the page after it.

    Partition, account, time limit and the like are taken from sbatch's own variables, such as
    SBATCH_PARTITION; see `man sbatch`. submitit is not used: it hands functions over as pickles,
    which hold code.

    Args:
        paths: The library.
        captures: Folder that holds all captures.
        tasks: Numbers of the captures in the plan that are to be done.
        memory: Bytes that the most hungry of them needs.

    Returns:
        Numbers of both jobs.

    Raises:
        UsageError: If there are more captures than an array may have.
        DeviceError: If Slurm is not there, or refuses.
    """
    if max(tasks) >= MOST_TASKS:
        raise UsageError(f"Slurm takes {MOST_TASKS} captures at a time; split the plan")
    log = f"--output={paths.own.absolute()}/slurm-%A-%a.log"
    # TERM a minute before the end: what is at work ends in good order, and is continued later
    array = ["--array", _ranges(tasks), "--requeue", "--signal=B:TERM@60", log]
    array += [f"--mem={-(-memory // _MIB)}M", "--cpus-per-task=1", "--job-name=robir"]
    variables = {
        "ROBIR_PYTHON": sys.executable,
        "ROBIR_LIBRARY": str(paths.root.absolute()),
        "ROBIR_CAPTURES": str(captures),
    }
    work = _sbatch(array, variables)
    after = ["--dependency", f"afterany:{work}", "--job-name=robir-page"]
    return work, _sbatch([*after, f"--output={paths.own.absolute()}/slurm-page.log"], variables)


def _ranges(tasks: Sequence[int]) -> str:
    """Rising numbers such as "0-3,7", which both schedulers read."""
    runs: list[list[int]] = []
    for task in tasks:
        if runs and task == runs[-1][1] + 1:
            runs[-1][1] = task
        else:
            runs.append([task, task])
    return ",".join(str(a) if a == b else f"{a}-{b}" for a, b in runs)


def _sbatch(words: Sequence[str], variables: Mapping[str, str]) -> str:
    command = ["sbatch", "--parsable", "--export=ALL", *words]
    try:
        done = subprocess.run(
            command,
            input=_SCRIPT,
            capture_output=True,
            env={**worker_environment(), **variables},
            check=False,
        )
    except OSError as error:
        raise DeviceError(f"sbatch cannot be run: {error.strerror}; is Slurm installed?") from error
    if done.returncode:
        said = done.stderr.decode(errors="replace").strip()
        raise DeviceError(f"Slurm takes no batch: {said}; see `man sbatch` for its variables")
    return done.stdout.decode().strip().partition(";")[0]


def _template(name: str, tasks: Sequence[int], memory: int) -> dict[str, Any]:
    """The job: one task a capture, then the page."""

    def run(*words: str) -> dict[str, Any]:
        common = ["-P", "-m", "robir", "batch", "--resume", "-o", "{{Param.Library}}"]
        args = [*common, "--captures", "{{Param.Captures}}", *words]
        cancel = {"mode": "NOTIFY_THEN_TERMINATE", "notifyPeriodInSeconds": 30}
        action = {"command": "{{Param.Python}}", "args": args, "cancelation": cancel}
        return {"actions": {"onRun": action}}

    def place(parameter: str, flow: str, text: str) -> dict[str, Any]:
        kind = {"type": "PATH", "objectType": "DIRECTORY", "dataFlow": flow}
        return {"name": parameter, "description": text, **kind}

    numbers = {"name": "Number", "type": "INT", "range": _ranges(tasks)}
    needs = [
        {"name": "amount.worker.vcpu", "min": 1},
        {"name": "amount.worker.memory", "min": -(-memory // _MIB)},
    ]
    python = {"name": "Python", "type": "STRING", "default": "python3"}
    return {
        "specificationVersion": "jobtemplate-2023-09",
        "name": f"RobIR {name}"[:128],
        "parameterDefinitions": [
            place("Library", "INOUT", "Results, assets and the contact sheet"),
            place("Captures", "IN", "Folder that holds all captures"),
            python | {"description": "Python that has robir"},
        ],
        "steps": [
            {
                "name": "Reconstruct",
                "parameterSpace": {"taskParameterDefinitions": [numbers]},
                "hostRequirements": {"amounts": needs},
                "script": run("--task", "{{Task.Param.Number}}"),
            },
            {
                "name": "Page",
                "dependencies": [{"dependsOn": "Reconstruct"}],
                "script": run("--page"),
            },
        ],
    }
