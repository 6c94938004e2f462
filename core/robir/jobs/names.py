# SPDX-License-Identifier: Apache-2.0
"""Names that come out of files, before they become paths: none leads out of its folder.

A capture and a result folder may have been made by anybody. What they name is looked at here, and
nowhere else, before the disk is asked for it.
"""

from __future__ import annotations

import errno
import os
import re
import stat
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

MAX_NAME_BYTES = 240  # that every usual file system takes, with room for a suffix of ours
_CONTROL = re.compile("[\0-\x1f\x7f]")

MAX_PATH_BYTES = 4000  # longest path that Linux takes, with room for a file name


class UnsafeNameError(ValueError):
    """A name cannot be a path, or leads somewhere else; the message says why."""


def checked_name(name: str) -> str:
    """A name or path that the system can be asked for, wherever it leads; `UnsafeNameError`."""
    try:
        size = len(name.encode("utf-8"))
    except UnicodeEncodeError:
        raise UnsafeNameError(f"the name {name[:40]!a} is no valid text") from None
    if _CONTROL.search(name):
        raise UnsafeNameError(f"the name {name[:40]!a} holds control characters")
    parts = name.replace("\\", "/").split("/")
    longest = max(map(len, parts))  # a letter has up to four bytes
    if 4 * longest > MAX_NAME_BYTES:
        longest = max(len(part.encode("utf-8")) for part in parts)
    if size > MAX_PATH_BYTES or longest > MAX_NAME_BYTES:
        raise UnsafeNameError(f"the name {name[:40]!a}... is too long ({size} bytes)")
    return name


def file_in(folder: Path, name: str) -> Path:
    """The file of a name directly in a folder, there or not; `UnsafeNameError` elsewhere."""
    if not isinstance(name, str):
        raise UnsafeNameError(f"a name is {type(name).__name__} instead of text")
    checked_name(name)
    separators = "/\\:" if os.name == "nt" else "/\\"
    if name in ("", ".", "..") or any(character in name for character in separators):
        raise UnsafeNameError(f"the name {name!a} leads out of {folder}")
    return folder / name


def leads_out(path: Path, folders: Iterable[Path]) -> bool:
    """Whether a path, there or not, lies in none of some folders once all links are followed."""
    real = os.path.realpath(path)
    homes = (os.path.realpath(folder) for folder in folders)
    return not any(real == home or real.startswith(home.rstrip(os.sep) + os.sep) for home in homes)


def open_regular(path: Path, flags: int = os.O_RDONLY, *, follows_links: bool = True) -> int:
    """Handle of a regular file for `os.fdopen`, which flags may make; for all else an OSError."""
    flags |= getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
    flags |= 0 if follows_links else getattr(os, "O_NOFOLLOW", 0)
    # a device may do something merely by being opened, so it is looked at first as well
    if os.path.lexists(path) or not flags & os.O_CREAT:
        _refuse_irregular(path.stat() if follows_links else path.lstat(), path)
    handle = os.open(path, flags, 0o644)
    try:
        _refuse_irregular(os.fstat(handle), path)
    except OSError:
        os.close(handle)
        raise
    return handle


def _refuse_irregular(found: os.stat_result, path: Path) -> None:
    if not stat.S_ISREG(found.st_mode):
        raise OSError(errno.EINVAL, "it is no regular file", str(path))


MAX_POSES_BYTES = 1 << 28  # of a file of poses; those of thousands of photographs have a tenth


@contextmanager
def regular(path: Path, most: int = MAX_POSES_BYTES) -> Iterator[BinaryIO]:
    """A regular file of sane size, opened for reading; everything a capture holds is read by it."""
    with os.fdopen(open_regular(path), "rb") as file:
        size = os.fstat(file.fileno()).st_size
        if size > most:
            raise OSError(f"{path.name} has {size} bytes; at most {most} are read")
        yield file


def read_regular(path: Path, most: int) -> bytes:
    """Contents of a regular file of up to so many bytes, links followed; else an `OSError`."""
    with regular(path, most) as file:
        return file.read(most)
