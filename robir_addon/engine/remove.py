# SPDX-License-Identifier: GPL-3.0-or-later
"""Removes the managed engine: what RobIR made there, and nothing else."""

import shutil
from contextlib import suppress
from pathlib import Path

from .errors import EngineError
from .lock import engine_lock
from .places import Place


def remove(place: Place) -> tuple[Path, ...]:
    """Remove the engine; files that are not RobIR's stay, and their folder with them.

    Args:
        place: The engine.

    Returns:
        What was left because it is not ours.

    Raises:
        EngineError: If the folder has not our mark, is a link, or a file is in use.
    """
    if place.root.is_symlink() or not place.marker.is_file():
        raise EngineError(
            f"{place.root} has no mark of RobIR and was not touched",
            "remove it by hand if it is not needed",
        )
    try:
        with engine_lock(place.lock):
            place.record.unlink(missing_ok=True)
            for folder in (place.environment, place.cache):
                _remove_folder(folder)
            place.log.unlink(missing_ok=True)
        place.lock.unlink(missing_ok=True)
        place.marker.unlink()
    except OSError as fault:
        raise EngineError(
            f"{fault.filename or place.root} cannot be removed ({fault.strerror})",
            "close reconstructions that use the engine, then press Remove again",
        ) from fault
    with suppress(OSError):
        place.root.rmdir()
        return ()
    return tuple(sorted(place.root.iterdir()))


def _remove_folder(folder: Path) -> None:
    """Remove a folder of ours; of a link only the link, for what it leads to may be anything."""
    if folder.is_symlink():
        folder.unlink()
    elif folder.exists():
        shutil.rmtree(folder)
