# SPDX-License-Identifier: Apache-2.0
"""Makes result folders, of other things never one, and has one process work in each at a time.

The lock is the operating system's lock on a file, so it goes with the process that holds it: the
lock of a killed process is free at once and the file it left is taken over.
"""

from __future__ import annotations

import errno
import os
import shutil
import sys
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from robir.errors import StorageError, UsageError
from robir.jobs.names import leads_out, open_regular
from robir.jobs.paths import JobPaths


def special_fault(root: Path, names: Iterable[str] | None = None) -> str | None:
    """What is wrong with a folder of ours that holds pipes, devices or links out of it, or None.

    A pipe stops who opens it, and what is written by way of a link lands elsewhere. `names` are
    those directly in it that are looked at; None for all.
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
    """Hold the lock file for the block, then remove it; `UsageError` if another process has it."""
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
