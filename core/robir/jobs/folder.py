# SPDX-License-Identifier: Apache-2.0
"""Makes a result folder, and never takes a folder that holds other things for one."""

from __future__ import annotations

import os
import stat
from pathlib import Path

from robir.errors import StorageError, UsageError
from robir.jobs.names import leads_out
from robir.jobs.paths import JobPaths


def special_fault(paths: JobPaths) -> str | None:
    """What is wrong with a result folder that holds pipes, devices or links out of it, or None.

    A pipe stops who opens it, and what is written by way of a link lands elsewhere.
    """
    for parent, folders, names in os.walk(paths.root):
        for name in (*folders, *names):
            path = Path(parent, name)
            if path.is_symlink() and leads_out(path, [paths.root]):
                return f"{path} is a link that leads out of the result folder; remove it"
            if _is_special(path):
                return f"{path} is neither a file nor a folder; remove it"
    return None


def refuse_special(paths: JobPaths) -> None:
    """Refuse a result folder that holds more than files and folders.

    Raises:
        UsageError: Names the first of what does not belong there.
    """
    if fault := special_fault(paths):
        raise UsageError(f"{fault}, or give another folder with -o")


def _is_special(path: Path) -> bool:
    try:
        kind = path.lstat().st_mode
    except OSError:
        return False  # another process has removed it meanwhile
    return not (stat.S_ISDIR(kind) or stat.S_ISREG(kind) or stat.S_ISLNK(kind))


def create(paths: JobPaths) -> None:
    """Make the result folder, or accept an existing one that is empty or ours.

    Raises:
        UsageError: If it holds other things, or what `refuse_special` refuses.
        StorageError: If it cannot be made.
    """
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
    refuse_special(paths)
    if strangers and not paths.run.exists():
        raise UsageError(
            f"{root} holds other files ({', '.join(sorted(strangers)[:3])}) and is not a result "
            "folder; give a new or empty folder with -o"
        )
