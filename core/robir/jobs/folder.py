# SPDX-License-Identifier: Apache-2.0
"""Makes a result folder, and never takes a folder that holds other things for one."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterable
from pathlib import Path

from robir.errors import StorageError, UsageError
from robir.jobs.names import leads_out
from robir.jobs.paths import JobPaths


def special_fault(root: Path, names: Iterable[str] | None = None) -> str | None:
    """What is wrong with a folder of ours that holds pipes, devices or links out of it, or None.

    A pipe stops who opens it, and what is written by way of a link lands elsewhere. Captures,
    results and libraries are all asked by this. `names` are those directly in it that are looked
    at; None for all.
    """
    home, found = Path(os.path.realpath(root)), [root]
    while found:
        folder = found.pop()
        try:
            entries = list(os.scandir(folder))
        except OSError:
            continue  # another process has removed it meanwhile, or it is not there yet
        for entry in entries:
            if folder is root and names is not None and entry.name not in names:
                continue
            if entry.is_symlink():
                if leads_out(Path(entry.path), [home]):
                    return f"{entry.path} is a link that leads out of {root}; remove it"
            elif entry.is_dir(follow_symlinks=False):
                found.append(Path(entry.path))
            elif not entry.is_file(follow_symlinks=False):
                return f"{entry.path} is neither a file nor a folder; remove it"
    return None


def refuse_special(root: Path, names: Iterable[str] | None = None) -> None:
    """Refuse a folder (`UsageError`) that holds more than files and folders."""
    if fault := special_fault(root, names):
        raise UsageError(f"{fault}, or give another folder with -o")


def is_full(folder: Path) -> bool:
    """Whether the disk of a folder, which need not be there yet, has less than a MiB of room."""
    there = next((one for one in (folder, *folder.absolute().parents) if one.exists()), folder)
    try:
        return shutil.disk_usage(there).free < 1 << 20
    except OSError:
        return False


def create(paths: JobPaths) -> None:
    """Make the result folder, or accept one that is empty or ours; UsageError or StorageError."""
    root = paths.root
    # what may be there before run.json: by its starter, or where that could not be written
    first = (paths.lock, paths.log, paths.cancel, paths.worker_log, paths.events)
    whole = (paths.run, paths.worker, paths.status)
    ours = {path.name for path in (*first, *whole)}
    halves = tuple(f".{path.stem}-" for path in whole)
    try:
        root.mkdir(parents=True, exist_ok=True)
        strangers = [
            path.name
            for path in root.iterdir()
            if path.name not in ours and not path.name.startswith(halves)
        ]
    except OSError as error:
        raise StorageError(
            f"the output folder {root} cannot be made: {error.strerror}; give another with -o"
        ) from error
    refuse_special(root)
    if strangers and not paths.run.exists():
        raise UsageError(
            f"{root} holds other files ({', '.join(sorted(strangers)[:3])}) and is not a result "
            "folder; give a new or empty folder with -o"
        )
