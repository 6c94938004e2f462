# SPDX-License-Identifier: Apache-2.0
"""Makes a result folder, and never takes a folder that holds other things for one."""

from __future__ import annotations

import os
from pathlib import Path

from robir.errors import StorageError, UsageError
from robir.jobs.names import leads_out
from robir.jobs.paths import JobPaths


def refuse_links(paths: JobPaths) -> None:
    """Refuse a result folder with links out of it: what is written there would land elsewhere.

    Raises:
        UsageError: Names the first of them.
    """
    for parent, folders, names in os.walk(paths.root):
        for name in (*folders, *names):
            path = Path(parent, name)
            if path.is_symlink() and leads_out(path, [paths.root]):
                raise UsageError(
                    f"{path} is a link that leads out of the result folder; remove it, or give "
                    "another folder with -o"
                )


def create(paths: JobPaths) -> None:
    """Make the result folder, or accept an existing one that is empty or ours.

    Raises:
        UsageError: If it holds other things, or links that lead out of it.
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
    refuse_links(paths)
    if strangers and not paths.run.exists():
        raise UsageError(
            f"{root} holds other files ({', '.join(sorted(strangers)[:3])}) and is not a result "
            "folder; give a new or empty folder with -o"
        )
