# SPDX-License-Identifier: GPL-3.0-or-later
"""One process works on the engine at a time; the lock of a killed one is free at once."""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from .errors import EngineError

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
