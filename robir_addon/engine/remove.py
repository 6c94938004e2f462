# SPDX-License-Identifier: GPL-3.0-or-later
"""Removes the managed engine: what RobIR made there, and nothing else.

Run apart from Blender (`places.worker_command`), for it takes a while: standard output carries JSON
lines {"progress": 0..1, "message": ...}, and at the end {"left": [names]} or {"error": ...,
"cure": ...}.
"""

import json
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from .errors import EngineError
from .places import Place

_EVERY = 200  # files between two reports
Progress = Callable[[float, str], None]


def main() -> int:
    """Remove the engine in the folder that the command line names; returns the exit code."""
    try:
        left = remove(
            Place(Path(sys.argv[1])), lambda share, text: _say(progress=share, message=text)
        )
    except EngineError as error:
        _say(error=error.message, cure=error.cure)
        return error.exit_code
    _say(left=[path.name for path in left])
    return 0


def _say(**report: object) -> None:
    sys.stdout.write(json.dumps(report) + "\n")
    sys.stdout.flush()


def remove(place: Place, progress: Progress = lambda *_: None) -> tuple[Path, ...]:
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
                _remove_folder(folder, progress)
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


def _remove_folder(folder: Path, progress: Progress) -> None:
    """Remove a folder of ours; of a link only the link, for what it leads to may be anything."""
    if folder.is_symlink():
        folder.unlink()
        return
    total = sum(len(files) for _, _, files in os.walk(folder))
    done = 0
    for parent, folders, files in os.walk(folder, topdown=False):
        for name in files:
            Path(parent, name).unlink()
            done += 1
            if done % _EVERY == 0:
                progress(done / total, f"removing {done} of {total} files")
        for name in folders:
            inner = Path(parent, name)
            inner.unlink() if inner.is_symlink() else inner.rmdir()
    if folder.exists():
        folder.rmdir()


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
