# SPDX-License-Identifier: Apache-2.0
"""One process works in a result folder at a time.

The lock is the operating system's lock on a file, so it goes with the process that holds it: the
lock of a killed process is free at once and the file it left is taken over.
"""

from __future__ import annotations

import errno
import os
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from robir.errors import UsageError
from robir.jobs.names import open_regular

if sys.platform == "win32":
    import msvcrt

    _FAR = 1 << 30

    def _try_lock(handle: int) -> None:
        """Lock one byte far behind the text, which others may then still read."""
        os.lseek(handle, _FAR, os.SEEK_SET)
        msvcrt.locking(handle, msvcrt.LK_NBLCK, 1)
        os.lseek(handle, 0, os.SEEK_SET)

else:
    import fcntl

    def _try_lock(handle: int) -> None:
        """Lock the whole file."""
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)


_TRIES = 5
_PAUSE = 0.05  # seconds between tries: `holder` has the lock for a moment when it finds it free


def holder(path: Path) -> int | None:
    """Process that holds a lock file: its number, 0 until it says so, or None for nobody."""
    try:
        try:
            handle = open_regular(path, os.O_RDWR, follows_links=False)
        except PermissionError:  # another user's run can be followed all the same
            handle = open_regular(path, follows_links=False)
    except OSError:
        return None
    try:
        _try_lock(handle)
    except OSError:
        text = os.read(handle, 32).decode(errors="replace").strip()
        return int(text) if text.isascii() and text.isdecimal() and len(text) < 10 else 0
    else:
        return None
    finally:
        os.close(handle)


@contextmanager
def folder_lock(path: Path) -> Iterator[None]:
    """Hold the lock file for the length of the block, and remove it at the end.

    `UsageError` if another process, which it names, holds it; or if it is a link or a pipe.
    """
    handle = _acquire(path)
    try:
        os.ftruncate(handle, 0)
        os.write(handle, f"{os.getpid()}\n".encode())
        yield
    finally:
        # On a disk that is read-only by now it stays; without a holder it means nothing.
        if sys.platform == "win32":
            os.close(handle)
            with suppress(OSError):
                path.unlink(missing_ok=True)
        else:
            with suppress(OSError):
                path.unlink(missing_ok=True)
            os.close(handle)


def _acquire(path: Path) -> int:
    tries = 0
    while True:
        try:
            handle = open_regular(path, os.O_RDWR | os.O_CREAT, follows_links=False)
        except OSError as error:
            if error.errno not in (errno.ELOOP, errno.EINVAL) or path.is_dir():
                raise
            raise UsageError(f"{path} is no lock but a link or a pipe; remove it") from error
        try:
            _try_lock(handle)
        except OSError as error:
            name = os.read(handle, 32).decode(errors="replace").strip() or "unknown"
            os.close(handle)
            tries += 1
            if tries < _TRIES:
                time.sleep(_PAUSE)
                continue
            raise UsageError(
                f"{path.parent} is in use by process {name}; wait for it, stop it, "
                "or give another output folder"
            ) from error
        # The holder before us may have removed the file between our open and our lock.
        if _is_still_at(handle, path):
            return handle
        os.close(handle)


def _is_still_at(handle: int, path: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(handle), path.stat())
    except FileNotFoundError:
        return False
