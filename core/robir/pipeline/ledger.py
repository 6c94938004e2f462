# SPDX-License-Identifier: Apache-2.0
"""What each stage left behind, and whether it still counts; what it was made of, as hashes.

| found in the stage's folder                        | state       | on resume                   |
|----------------------------------------------------|-------------|-----------------------------|
| manifest, fingerprint equal, outputs as recorded   | done        | skip                        |
| manifest, fingerprint or an output differs         | stale       | move to `.stale`, run       |
| files but no manifest                              | interrupted | clear, run from the start   |
| nothing                                            | absent      | run                         |
"""

from __future__ import annotations

import hashlib
import os
import re
import shutil
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Literal, Protocol

from robir.capture.frames import IMAGE_SUFFIXES
from robir.capture.images.decode import MAX_FILE_BYTES
from robir.capture.mesh_file import mesh_parts
from robir.capture.poses.sources import MAX_BYTES, is_video
from robir.config import RunConfig, fingerprint
from robir.constants import of_stage
from robir.errors import CaptureError, QualityError, StorageError
from robir.jobs.context import StageContext
from robir.jobs.names import leads_out, open_regular
from robir.jobs.paths import STAGES, JobPaths, write_json
from robir.jobs.records import read_record
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
    of_run = (paths.run, paths.config, paths.status, paths.preview, paths.growing, paths.mesh_fit)
    for file in (*of_run, paths.library_asset, paths.usd, paths.library_facts):
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


_POSES = (".json", ".npz", ".npy", ".bin", ".txt", ".csv", ".xml", ".sfm")
_SUFFIXES = frozenset([*_POSES, ".exr", *IMAGE_SUFFIXES])  # no videos, no archives
_TRUTH = "truth"  # ground truth is never an input of a reconstruction


def is_capture_file(path: Path) -> bool:
    """Whether a regular file may be a capture by itself: a video, or one of poses."""
    return path.is_file() and (is_video(path) or path.suffix.lower() in _POSES)


def file_hash(path: Path) -> str:
    """SHA-256 of a regular file, 64 hex digits; an OSError names it, as a bad block does not."""
    with os.fdopen(open_regular(path), "rb") as file:
        try:
            return hashlib.file_digest(file, "sha256").hexdigest()
        except OSError as error:
            raise OSError(error.errno, error.strerror, str(path)) from error


def mesh_fingerprint(mesh: Path | None) -> str:
    """SHA-256 of the files of the user's mesh, "" without one; else a `CaptureError`."""
    if mesh is None:
        return ""
    if not mesh.is_file():
        raise CaptureError(f"the mesh {mesh} does not exist; check the path")
    digest = hashlib.sha256()
    for name, content in sorted(mesh_parts(mesh).items()):
        digest.update(os.fsencode(name) + b"\0" + hashlib.sha256(content).digest())
    return digest.hexdigest()


def capture_fingerprint(
    source: Path, masks: Path | None, out: Path, follows_links: bool = False
) -> str:
    """SHA-256 of the names and contents of all files of a capture and its masks.

    The result is left out; links lead on as `capture.outside` says. `CaptureError` if unreadable.
    """
    for name, path in (("capture", source), ("masks folder", masks)):
        if path is not None and not path.exists():
            raise CaptureError(f"the {name} {path} does not exist; check the path")
    digest = hashlib.sha256()
    try:
        if is_video(source):
            if source.stat().st_size > MAX_BYTES:
                raise CaptureError(f"the video {source} is too large; cut it")
            digest.update(file_hash(source).encode())
            folders = [masks]
        else:
            folders = [source if source.is_dir() else source.parent, masks]
        for folder in filter(None, folders):
            for path in _files(folder, out.resolve(), follows_links):
                digest.update(os.fsencode(path.relative_to(folder).as_posix()) + b"\0")
                digest.update(file_hash(path).encode())
            digest.update(b"\n")
    except OSError as error:
        raise CaptureError(f"cannot read {error.filename}: {error.strerror}") from error
    return digest.hexdigest()


def _files(folder: Path, out: Path, follows_links: bool) -> Iterator[Path]:
    """Regular files of a capture in a fixed order; linked folders are followed once, if at all."""
    seen = {os.path.realpath(folder)}
    for parent, folders, names in os.walk(folder, followlinks=follows_links):
        folders[:] = sorted(
            name
            for name in folders
            if not name.startswith(".")
            and name != _TRUTH
            and Path(os.path.realpath(Path(parent, name))) != out
            and os.path.realpath(Path(parent, name)) not in seen
        )
        seen.update(os.path.realpath(Path(parent, name)) for name in folders)
        for name in sorted(names):
            path = Path(parent, name)
            if path.suffix.lower() not in _SUFFIXES or name.startswith("."):
                continue
            is_ours = follows_links or not path.is_symlink() or not leads_out(path, [folder])
            if is_ours and path.is_file() and path.stat().st_size <= MAX_FILE_BYTES:
                yield path
