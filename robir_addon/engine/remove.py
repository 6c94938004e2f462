# SPDX-License-Identifier: GPL-3.0-or-later
"""Removes the managed engine: what RobIR made there, and nothing else.

Run apart from Blender (`places.worker_command`), for it takes a while: standard output carries a
JSON line {"progress": 0, "message": ...}, and {"left": [names]} or {"error": ..., "cure": ...}.
"""

import json
import os
import shutil
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from .errors import EngineError
from .places import Place


def main() -> int:
    """Remove the engine in the folder that the command line names; returns the exit code."""
    _say(progress=0.0, message="removing the engine")
    try:
        left = remove(Place(Path(sys.argv[1])))
    except EngineError as error:
        _say(error=error.message, cure=error.cure)
        return error.exit_code
    _say(left=[path.name for path in left])
    return 0


def _say(**report: object) -> None:
    sys.stdout.write(json.dumps(report) + "\n")
    sys.stdout.flush()


def remove(place: Place) -> tuple[Path, ...]:
    """Remove the engine; files that are not RobIR's stay, and their folder with them."""
    if place.root.is_symlink() or not place.marker.is_file():
        raise EngineError(
            f"{place.root} has no mark of RobIR and was not touched",
            "remove it by hand if it is not needed",
        )
    try:
        with engine_lock(place.lock):
            place.record.unlink(missing_ok=True)
            for folder in (place.environment, place.cache):
                if folder.is_symlink():  # what it leads to may be anything
                    folder.unlink()
                elif folder.exists():
                    shutil.rmtree(folder)
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


if sys.platform == "win32":
    import msvcrt

    def _try_lock(handle: int) -> None:
        """Lock the first byte."""
        msvcrt.locking(handle, msvcrt.LK_NBLCK, 1)

else:
    import fcntl

    def _try_lock(handle: int) -> None:
        """Lock the whole file."""
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)


@contextmanager
def engine_lock(path: Path) -> Iterator[None]:
    """Hold the lock file for the length of the block; the file stays."""
    handle = os.open(path, os.O_RDWR | os.O_CREAT, 0o644)
    try:
        try:
            _try_lock(handle)
        except OSError:
            raise EngineError(
                "another process is installing or removing the engine", "wait until it is done"
            ) from None
        yield
    finally:
        os.close(handle)
