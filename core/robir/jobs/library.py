# SPDX-License-Identifier: Apache-2.0
"""Every file name of a library of results, and the batch that fills it: started and followed."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, get_args

from robir.jobs.client import spawn
from robir.jobs.folder import holder, special_fault
from robir.jobs.names import UnsafeNameError, file_in
from robir.jobs.paths import JobPaths, Named
from robir.jobs.records import read_record

Format = Literal["glb", "usd", "blend"]

FORMATS: tuple[Format, ...] = get_args(Format)  # what a library may offer of each result
_STATE = {
    "fraction": float, "seconds_left": (None, float),
    "captures": [{"name": str, "state": str, "fraction": float, "message": str}],
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class LibraryPaths:
    """Names of a library's files; nothing else may spell them."""

    root: Path  # the library, LIBRARY on the command line

    plan = Named("plan.json")  # what is to be reconstructed, all paths relative
    state = Named("batch.json")  # where the batch stands; replaced as a whole
    lock = Named("batch.lock")  # held by the one batch that works on the whole library
    page = Named("index.html")  # the contact sheet
    catalogues = Named("blender_assets.cats.txt")  # the name that Blender wants
    openjd = Named("openjd")  # job bundle for render farms
    own = Named(".batch")  # the batch's own small files

    @property
    def taken(self) -> frozenset[str]:
        """Names that no result may have."""
        files = (self.plan, self.state, self.lock, self.page, self.catalogues, self.openjd)
        return frozenset(file.name for file in (*files, self.own))

    def result(self, name: str) -> JobPaths:
        """Result folder of a capture; an `UnsafeNameError` if the name leads elsewhere."""
        return JobPaths(file_in(self.root, name))

    def facts(self, name: str) -> Path:
        """What is known of a capture's asset: author, licence, tags."""
        return file_in(self.own, f"{name}.toml")

    dropped = Named(".batch/dropped")  # a file of a capture's name here leaves that out
    preferred = Named(".batch/preferred")  # captures of these names first, the last touched first


def refuse_strange(paths: LibraryPaths, results: Iterable[str] = ()) -> None:
    """Refuse (`UnsafeNameError`) a library whose files or results are links out of it or pipes."""
    if fault := special_fault(paths.root, {*paths.taken, *results}):
        raise UnsafeNameError(fault)


def read_batch(paths: LibraryPaths) -> dict[str, Any]:
    """Where the batch stands: "fraction", "seconds_left", "captures"; OSError or ValueError."""
    refuse_strange(paths)
    return read_record(paths.state, _STATE)


def start_batch(
    program: Sequence[str],
    sources: Sequence[str],
    paths: LibraryPaths,
    environment: Mapping[str, str],
) -> None:
    """Start a batch of absolute captures, a plan or the library's own, that outlives us."""
    refuse_strange(paths)
    paths.own.mkdir(parents=True, exist_ok=True)
    words = ["batch", *sources, "-o", str(paths.root), "--resume", "--progress", "plain"]
    spawn([*program, *words], paths.root, paths.own / "log.txt", environment)


def stop_batch(paths: LibraryPaths) -> None:
    """End the batch that is at work, if one is; what it has at work ends in good order."""
    pid = holder(paths.lock)
    if pid:
        with suppress(ProcessLookupError):
            os.kill(pid, signal.SIGTERM)


def drop(paths: LibraryPaths, name: str) -> None:
    """Have the batch leave a capture out; an `OSError` if that cannot be noted."""
    _touch(paths, paths.dropped, name)


def prefer(paths: LibraryPaths, name: str) -> None:
    """Have a batch here do a capture before all that wait; an `OSError` if that cannot be noted."""
    _touch(paths, paths.preferred, name)


def preferred(paths: LibraryPaths) -> list[str]:
    """Names of the captures that come first, in their order."""
    folder = paths.preferred
    files = list(folder.iterdir()) if folder.is_dir() else []
    return [file.name for file in sorted(files, key=lambda file: -file.stat().st_mtime_ns)]


def _touch(paths: LibraryPaths, folder: Path, name: str) -> None:
    refuse_strange(paths)
    file = file_in(folder, name)
    file.parent.mkdir(parents=True, exist_ok=True)
    file.touch()
