# SPDX-License-Identifier: Apache-2.0
"""What each stage left behind, and whether it still counts.

| found in the stage's folder                        | state       | on resume                   |
|----------------------------------------------------|-------------|-----------------------------|
| manifest, fingerprint equal, outputs as recorded   | done        | skip                        |
| manifest, fingerprint or an output differs         | stale       | move to `.stale`, run       |
| files but no manifest                              | interrupted | clear, run from the start   |
| nothing                                            | absent      | run                         |
"""

from __future__ import annotations

import re
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal, Protocol

from robir.config import RunConfig, fingerprint
from robir.constants import of_stage
from robir.errors import QualityError, StorageError
from robir.jobs.context import StageContext
from robir.jobs.names import leads_out
from robir.jobs.paths import STAGES, JobPaths, write_json
from robir.jobs.records import read_record
from robir.pipeline.inputs import file_hash
from robir.settings import table_from_settings

_MANIFEST = {
    "fingerprint": str, "metrics?": {}, "outputs": {...: {"sha256": str, "bytes": int}}
}  # fmt: skip

StageState = Literal["done", "stale", "interrupted", "absent"]


class StageModule(Protocol):
    """A stage as the runner sees it: the module `robir.<stage>.stage`."""

    REVISION: int

    def run(self, context: StageContext[Any]) -> Mapping[str, Any]:
        """Read the earlier stages' files, write one's own, return metrics."""
        ...


def stage_fingerprints(
    config: RunConfig, revisions: Mapping[str, int], capture: str, mesh: str = ""
) -> dict[str, str]:
    """Fingerprint of each stage: settings, constants, seed, revision and all that came before."""
    result: dict[str, str] = {}
    upstream = fingerprint(capture, mesh) if mesh else capture
    for stage in STAGES:
        settings = table_from_settings(getattr(config, stage))
        constants = of_stage(config.constants, stage, STAGES)
        facts = (settings, constants) if constants else settings
        upstream = fingerprint(stage, facts, config.seed, revisions[stage], upstream)
        result[stage] = upstream
    return result


def stage_state(paths: JobPaths, stage: str, expected: str) -> StageState:
    """State of a stage's files against the fingerprint it should have."""
    if not paths.manifest(stage).exists():
        folder = paths.stage(stage)
        return "interrupted" if folder.exists() and any(folder.iterdir()) else "absent"
    try:
        manifest = read_record(paths.manifest(stage), _MANIFEST)
    except (ValueError, OSError):
        return "stale"
    is_same, outputs = manifest["fingerprint"] == expected, manifest["outputs"]
    is_whole = all(_is_as_recorded(paths, name, facts) for name, facts in outputs.items())
    return "done" if is_same and is_whole else "stale"


def write_manifest(paths: JobPaths, stage: str, facts: Mapping[str, Any]) -> None:
    """Write a stage's manifest with the hashes of its outputs; the stage is done from then on."""
    outputs = {
        path.relative_to(paths.root).as_posix(): {
            "sha256": file_hash(path),
            "bytes": path.stat().st_size,
        }
        for folder in _folders(paths, stage)
        for path in sorted(folder.rglob("*"))
        if path.is_file() and path != paths.manifest(stage)
    }
    write_json(paths.manifest(stage), {"stage": stage, **facts, "outputs": outputs})


def judged(paths: JobPaths) -> QualityError | None:
    """What the quality check of the export stage's manifest has against a result, or None."""
    if not paths.manifest(STAGES[-1]).exists():
        return None
    metrics = read_record(paths.manifest(STAGES[-1]), _MANIFEST).get("metrics", {})
    if metrics.get("is_trusted", True):
        return None
    return QualityError(f"it failed its own quality check: see the warnings, or {paths.report}")


def clear_for_rerun(paths: JobPaths, stage: str, state: StageState) -> None:
    """Make room for a stage that has to run: stale results are kept aside, halves go."""
    renders = [paths.renders] if stage == STAGES[-1] else []
    # The stage's own folder goes last: as long as its manifest is there, the stage is stale.
    folders = [folder for folder in (*renders, *_folders(paths, stage)) if folder.exists()]
    try:
        if state == "stale":
            aside = _aside(paths, stage)
            for folder in folders:
                target = aside / folder.relative_to(paths.root)
                target.parent.mkdir(parents=True, exist_ok=True)
                folder.replace(target)
        else:
            for folder in folders:
                shutil.rmtree(folder)
    except OSError as error:
        raise StorageError(f"cannot clear {error.filename}: {error.strerror}") from error


def remove_leftovers(paths: JobPaths) -> None:
    """Remove half-written files of a killed process where no stage clears its folder again."""
    of_run, of_asset = (paths.run, paths.config, paths.status), (paths.library_asset, paths.usd)
    for file in (*of_run, *of_asset, paths.library_facts):
        # what Blender has not written to the end bears a further @
        for leftover in file.parent.glob(f".{file.stem}-*{file.suffix}*"):
            leftover.unlink(missing_ok=True)


def _folders(paths: JobPaths, stage: str) -> list[Path]:
    """Folders a stage writes to; the last stage also makes what the user takes away."""
    products = [paths.export, paths.report.parent] if stage == STAGES[-1] else []
    return [*products, paths.stage(stage)]


def _aside(paths: JobPaths, stage: str) -> Path:
    try:
        tag = read_record(paths.manifest(stage), _MANIFEST)["fingerprint"][:8]
    except (ValueError, OSError):
        tag = ""
    tag = tag if re.fullmatch("[0-9a-f]{8}", tag) else "damaged"
    number = 0
    while True:
        suffix = f"-{number}" if number else ""
        aside = paths.stale / f"{stage}-{tag}{suffix}"
        try:
            aside.mkdir(parents=True)
            return aside
        except FileExistsError:
            number += 1


def _is_as_recorded(paths: JobPaths, name: str, facts: Mapping[str, Any]) -> bool:
    """Whether an output is there, unchanged; the user may edit what is theirs to take away."""
    path = paths.root / name
    if "\0" in name or not path.is_file() or leads_out(path, [paths.root]):
        return False
    is_product = not path.is_relative_to(paths.root / "stages")
    return is_product or (
        path.stat().st_size == facts["bytes"] and file_hash(path) == facts["sha256"]
    )
