# SPDX-License-Identifier: Apache-2.0
"""Opens a result folder: whose it is, what is in it, and whether a run may go on in it."""

from __future__ import annotations

import hashlib
import os
import platform
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any

from robir import __version__
from robir.config import RunConfig
from robir.errors import ConfigError, StorageError, UsageError
from robir.jobs.paths import JobPaths
from robir.jobs.records import read_record
from robir.pipeline.device import Execution
from robir.settings import changed_settings, read_toml, settings_from_table, table_from_settings

_RUN = {
    "state": str,
    "capture": {
        "name": str, "place": str, "masks": (None, str), "fingerprint": str,
        "mesh?": (None, {"name": str, "fingerprint": str}),
    },
    "seconds": {...: {"wall": float, "cpu": float}}, "peak_memory_bytes": {...: int},
    "warnings": [{"stage": str, "message": str}],
}  # fmt: skip


def read_run(paths: JobPaths) -> dict[str, Any] | None:
    """What `run.json` says, or None where no run has begun; a `StorageError` if it is damaged."""
    if not paths.run.exists():
        return None
    try:
        return read_record(paths.run, _RUN)
    except (OSError, ValueError) as error:
        raise StorageError(
            f"{paths.run} is damaged ({error}); give another output folder with -o"
        ) from error


def read_config(paths: JobPaths) -> RunConfig:
    """The configuration of a run; a `ConfigError` if it is damaged or of other settings."""
    return settings_from_table(RunConfig, read_toml(paths.config), str(paths.config))


def new_run(*, capture: dict[str, Any], config: RunConfig, execution: Execution) -> dict[str, Any]:
    """Contents of `run.json` before the first stage; `capture` is that of `capture_facts`."""
    system = f"{platform.system()} {platform.machine()}"
    made = {"robir_version": __version__, "python": platform.python_version(), "platform": system}
    made |= {"torch": version("torch"), "device": execution.device, "threads": execution.threads}
    made |= {"seed": config.seed, "state": "running", "capture": capture}
    return made | {"seconds": {}, "peak_memory_bytes": {}, "warnings": []}


def capture_facts(
    source: Path, masks: Path | None, mesh: Path | None, fingerprints: tuple[str, str]
) -> dict[str, Any]:
    """What `run.json` says of a run's inputs: no path, for the folder travels."""
    capture, shape = fingerprints
    return {
        "name": source.resolve().name,
        "place": _place(source),
        "masks": None if masks is None else masks.resolve().name,
        "mesh": None if mesh is None else {"name": mesh.name, "fingerprint": shape},
        "fingerprint": capture,
    }


def _place(source: Path) -> str:
    """What tells one folder of this machine from others without naming it."""
    return hashlib.sha256(os.fsencode(source.resolve())).hexdigest()[:16]


def refuse_unnamed(
    paths: JobPaths, run: Mapping[str, Any], option: str, given: Path | None
) -> None:
    """Refuse to go on without the "masks" or "mesh" that a run was begun with."""
    before = run["capture"].get(option)
    if before is not None and given is None:
        name = (before if option == "masks" else before["name"])[:200]
        raise UsageError(
            f"{paths.root} was begun with the {option} {name!r}; name the same with --{option}, "
            "or give another output folder with -o"
        )


def refuse_other_mesh(
    paths: JobPaths, run: Mapping[str, Any], mesh: Path | None, fingerprint: str
) -> None:
    """Refuse (`UsageError`) another mesh, or the first one, where there is a surface already."""
    before = run["capture"].get("mesh") or {"name": "no mesh", "fingerprint": ""}
    if before["fingerprint"] != fingerprint and paths.manifest("geometry").exists():
        raise UsageError(
            f"{paths.root} was made with {before['name']}, not with "
            f"{'no mesh' if mesh is None else mesh.resolve()} as it is now; "
            "give another output folder with -o"
        )


def refuse_other_capture(
    paths: JobPaths, run: Mapping[str, Any], source: Path, capture: str
) -> None:
    """Refuse (`UsageError`) to mix two captures in one result folder."""
    before = run["capture"]
    if before["place"] != _place(source) and before["fingerprint"] != capture:
        raise UsageError(
            f"{paths.root} holds the result of {before['name']}, not of {source.resolve()}; "
            "give another output folder with -o"
        )


def refuse_without_resume(
    paths: JobPaths, run: Mapping[str, Any], capture: str, config: RunConfig
) -> None:
    """Refuse (`UsageError`) to touch an unfinished result folder, unless told to resume."""
    if run["state"] == "running":
        raise UsageError(
            f"{paths.root} holds an unfinished run; continue it with --resume, "
            "or give another output folder with -o"
        )
    try:
        before = table_from_settings(read_config(paths))
        changes = changed_settings(before, table_from_settings(config))
    except ConfigError:
        changes = []
    if run["capture"]["fingerprint"] != capture:
        changes.insert(0, "the capture's files have changed")
    what = "; ".join(changes[:5]) or "made by another version, or files of it were changed"
    raise UsageError(
        f"{paths.root} holds a finished run that differs from this one ({what}); redo the stages "
        "concerned with --resume, or give another output folder with -o"
    )
