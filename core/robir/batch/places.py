# SPDX-License-Identifier: Apache-2.0
"""Where the captures of a plan lie and what their results are called, looked at before anything."""

from __future__ import annotations

import errno
import fnmatch
import functools
import os
import re
import unicodedata
from pathlib import Path

from robir.errors import UsageError
from robir.jobs.library import LibraryPaths
from robir.jobs.names import UnsafeNameError, checked_name, file_in
from robir.pipeline.ledger import is_capture_file

_WILD = re.compile(r"[*?[]")
# names that Windows keeps for devices, whatever follows a dot
_RESERVED = re.compile(r"(?:con|prn|aux|nul|com[0-9]|lpt[0-9])(?:\..*)?", re.IGNORECASE)
_MOST_PLACES = 100_000  # captures that one path with `*` may stand for


def absolute(path: str) -> Path:
    """A path from the root, normalised without a look at the disk: links keep their names."""
    return Path(os.path.normpath(Path(path).absolute()))


def places(path: str, where: str) -> list[Path]:
    """The capture of a path, or all folders that `*`, `?` and `[...]` match; or a UsageError."""
    where = where or "the command line"
    try:
        place = absolute(checked_name(path))
        if not _WILD.search(path) or place.exists():
            return [_capture(place, where)]
        found = _matching(place, where)
        for one in found:
            checked_name(str(one))
    except UnsafeNameError as fault:
        raise UsageError(f"{where}: {fault}; give another path") from None
    except OSError as error:
        raise UsageError(f"{where}: {error.filename}: {error.strerror}") from error
    if not found:
        raise UsageError(f"{where}: {path} matches no folder")
    return found


def folder_of_masks(path: str, where: str) -> str:
    """An absolute path of a folder that is there, or "" for none; else a `UsageError`."""
    if not path:
        return ""
    place = absolute(path)
    if not place.is_dir():
        raise UsageError(f"{where or 'the command line'}: {path!a} is no folder of masks")
    return str(place)


def name_of_result(given: str, place: Path, where: str, paths: LibraryPaths) -> str:
    """The name of a result folder, good on every system; "" takes the capture's own."""
    own = place.stem if place.is_file() else place.name
    name = re.sub(r"[^\w.-]+", "_", unicodedata.normalize("NFC", given or own))
    name = name.strip("._") or "capture"
    try:
        file_in(paths.own, f"{name}.toml")
        fault = "Windows keeps it for a device" if _RESERVED.fullmatch(name) else ""
    except UnsafeNameError as error:
        fault = str(error)
    if key_of(name) in _taken(paths):
        fault = f"the library needs the name {name}"
    if fault:
        raise UsageError(
            f"{where + ': ' if where else ''}no result can be called {name[:40]!a}: {fault}; "
            "give another name in a plan"
        )
    return name


def key_of(name: str) -> str:
    """What two names have in common that some system takes for one."""
    return unicodedata.normalize("NFKC", unicodedata.normalize("NFKC", name).casefold())


@functools.cache
def _taken(paths: LibraryPaths) -> frozenset[str]:
    return frozenset(map(key_of, paths.taken))


def _capture(place: Path, where: str) -> Path:
    if not place.exists():
        raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), str(place))
    if not place.is_dir() and not is_capture_file(place):
        raise UsageError(f"{where}: {place} is neither a folder, a video nor a file of poses")
    return place


def _matching(place: Path, where: str) -> list[Path]:
    """Folders that a path with wild cards matches, sorted."""
    found, parts = [Path(place.anchor)], place.parts[1:]
    for number, part in enumerate(parts):
        if "**" in part:
            raise UsageError(f"{where}: {place}: ** is not read; write * for one folder")
        if not _WILD.search(part):
            found = [folder / part for folder in found if (folder / part).is_dir()]
            continue
        # links to folders above would match themselves for ever
        found = [
            Path(entry.path)
            for folder in found
            for entry in os.scandir(folder)
            if entry.name[:1] != "."
            and fnmatch.fnmatchcase(entry.name, part)
            and entry.is_dir(follow_symlinks=number == len(parts) - 1)
        ]
        if len(found) > _MOST_PLACES:
            raise UsageError(f"{where}: {place} matches more than {_MOST_PLACES} folders")
    return sorted(found)
