# SPDX-License-Identifier: Apache-2.0
"""What a batch is to do: from PLAN.toml or the captures themselves, kept in the library.

In the library every path is relative: the captures to a folder that holds them all, that folder to
the library. So a library may be moved with its captures, and a farm may map either elsewhere.
"""

from __future__ import annotations

import errno
import fnmatch
import functools
import os
import re
import unicodedata
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Literal

from robir.config import RunConfig, resolve
from robir.errors import ConfigError, StorageError, UsageError
from robir.export.asset import MADE, AssetFacts, Made
from robir.jobs.client import Request
from robir.jobs.library import Format, LibraryPaths
from robir.jobs.names import UnsafeNameError, checked_name, file_in
from robir.jobs.paths import read_json, write_json
from robir.pipeline.ledger import is_capture_file
from robir.settings import checked_table, read_toml, settings_from_table, table_from_settings

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


_SIZE = re.compile(r"(\d+(?:\.\d+)?) ?([KMGT])B?", re.IGNORECASE)
_UNITS = {"K": 2**10, "M": 2**20, "G": 2**30, "T": 2**40}


@dataclass(frozen=True, slots=True, kw_only=True)
class Entry:
    """One capture of a plan."""

    # the capture; in PLAN.toml from the plan's folder, with `*` for many, in the library from the
    # folder of captures
    path: str
    name: str = ""  # of its result folder; empty for that of the capture
    settings: tuple[str, ...] = ()  # items as of `--set`
    masks: str = ""  # folder of masks, as `path`; empty for the capture's own
    memory: str = ""  # what it needs, such as "3G"; empty to estimate it
    author: str = ""  # as in `AssetFacts`, and so are the next three
    licence: str = ""  # of the asset
    tags: tuple[str, ...] = ()  # of the asset
    catalogue: str = ""  # of the asset; empty for its first tag, else the folder of the capture

    @property
    def about(self) -> dict[str, Any]:
        """What is known of its asset."""
        return {key: getattr(self, key) for key in ("author", "licence", "tags", "catalogue")}

    def config(self) -> RunConfig:
        """The resolved settings, or a `ConfigError`."""
        return _resolved(self.settings)


@dataclass(frozen=True, slots=True, kw_only=True)
class Options:
    """What holds for the whole library."""

    device: Literal["auto", "cpu", "cuda"] = "auto"  # as of `robir reconstruct`
    textures: Literal["packed", "relative"] = "packed"  # of the assets; see `AssetFacts`
    # what the library offers of each result: "glb", "usd", and "blend", which makes it an asset of
    # Blender's library
    formats: tuple[Format, ...] = ("glb", "blend")

    @property
    def made(self) -> tuple[Made, ...]:
        """Those of the formats that not every result has."""
        return tuple(kind for kind in MADE if kind in self.formats)


@dataclass(frozen=True, slots=True, kw_only=True)
class Plan:
    """What a batch is to do."""

    captures: Path  # folder that the entries' paths start from, absolute
    entries: tuple[Entry, ...]  # one a result, of different names
    options: Options = Options()  # what holds for all

    def request(self, entry: Entry, paths: LibraryPaths) -> Request:
        """The reconstruction of an entry."""
        return Request(
            capture=self.captures / entry.path,
            out=paths.result(entry.name).root.absolute(),
            device=self.options.device,
            masks=self.captures / entry.masks if entry.masks else None,
            settings=entry.settings,
            asset=paths.facts(entry.name).absolute() if self.options.made else None,
        )

    def facts(self, entry: Entry) -> AssetFacts:
        """What is known of an entry's asset."""
        options: dict[str, Any] = {"textures": self.options.textures, "formats": self.options.made}
        return AssetFacts(**entry.about, **options)


def read_plan(sources: Sequence[str], changes: Mapping[str, Any], paths: LibraryPaths) -> Plan:
    """What PLAN.toml says, or the captures that are named, with changes to each `Entry`.

    Settings are added to the plan's own. `ConfigError` if the plan is wrong, `UsageError` if there
    is no capture, two have one name, or the library needs that itself.
    """
    if len(sources) == 1 and sources[0].endswith(".toml"):
        tables, options = _tables(Path(sources[0]))
    else:
        tables, options = [("", {"path": source}) for source in sources], Options()
    found = [
        (where, entry)
        for where, table in tables
        for entry in _entries(where, table, changes, paths)
    ]
    if not found:
        raise UsageError("there is no capture to reconstruct; name captures or a plan of some")
    _refuse_twins(found)
    files = [Path(entry.path).parent for _, entry in found]
    files += [Path(entry.masks) for _, entry in found if entry.masks]
    root = Path(os.path.commonpath(files))
    return Plan(
        captures=root, entries=tuple(_from(root, entry) for _, entry in found), options=options
    )


def keep_plan(plan: Plan, paths: LibraryPaths) -> None:
    """Write the plan into its library."""
    captures = Path(os.path.relpath(plan.captures, paths.root.absolute())).as_posix()
    about = table_from_settings(plan.options) | {"captures": captures}
    entries = [table_from_settings(entry) for entry in plan.entries]
    write_json(paths.plan, about | {"entries": entries})


def kept_plan(paths: LibraryPaths, captures: Path | None) -> Plan:
    """The plan of a library, its captures elsewhere if given; UsageError or StorageError."""
    try:
        table = dict(read_json(paths.plan))
        folder, entries = table.pop("captures"), table.pop("entries")
        for entry in entries:
            file_in(paths.root, entry["name"])
        plan = Plan(
            captures=(captures or paths.root / folder).resolve(),
            entries=tuple(settings_from_table(Entry, entry, str(paths.plan)) for entry in entries),
            options=settings_from_table(Options, table, str(paths.plan)),
        )
    except FileNotFoundError as error:
        raise UsageError(f"{paths.root} holds no batch to go on with; name its captures") from error
    except (OSError, ValueError, TypeError, LookupError, AttributeError, ConfigError) as error:
        raise StorageError(
            f"{paths.plan} is damaged ({error}); start the batch again with its plan"
        ) from error
    if not plan.entries:
        raise StorageError(f"{paths.plan} is damaged: it names no captures; give its plan again")
    return plan


def parse_size(text: str) -> int:
    """Bytes of a text such as "8G", or a `ConfigError`."""
    size = _SIZE.fullmatch(text.strip())
    if size is None:
        raise ConfigError(f"{text!r} is no size; write it as 8G or 900M")
    return int(float(size[1]) * _UNITS[size[2].upper()])


def _tables(path: Path) -> tuple[list[tuple[str, dict[str, Any]]], Options]:
    """Where each [[capture]] of a plan stands, and its values with the plan's own below them."""
    table = read_toml(path)
    captures = table.pop("capture", None)
    if not isinstance(captures, list) or not all(isinstance(item, dict) for item in captures):
        raise ConfigError(f"{path}: it names no captures; give each a table [[capture]] with path")
    known = {field.name for field in fields(Options)}
    lines = path.read_text(encoding="utf-8").splitlines()
    starts = [n for n, line in enumerate(lines, 1) if re.match(r"\s*\[\[\s*capture\s*\]\]", line)]
    if len(starts) != len(captures):  # written as a list in one line
        starts = [1] * len(captures)
    options = {key: value for key, value in table.items() if key in known}
    shared = {key: value for key, value in table.items() if key not in known}
    _check(Options, options, path, lines, 0)
    _check(Entry, shared, path, lines, 0)
    tables = []
    for start, end, capture in zip(starts, [*starts[1:], len(lines)], captures, strict=True):
        where = f"{path}, line {start}"
        _check(Entry, capture, path, lines[: max(start, end)], start)
        if not capture.get("path"):
            raise ConfigError(f"{where}: this capture has no path; add path = 'folder'")
        places = {
            key: str(path.parent / capture[key]) for key in ("path", "masks") if key in capture
        }
        tables.append((where, shared | capture | places))
    return tables, settings_from_table(Options, options, str(path))


def _check(cls: type, table: Mapping[str, Any], path: Path, lines: list[str], start: int) -> None:
    """Refuse an unknown key or a wrong type with the line that it stands in."""
    for key, value in table.items():
        place = re.compile(rf"\s*[\"']?{re.escape(key)}[\"']?\s*=")
        found = (n for n, line in enumerate(lines[start:], start + 1) if place.match(line))
        number = next(found, 1)
        checked_table(cls, {key: value}, f"{path}, line {number}")


def _entries(
    where: str, table: Mapping[str, Any], changes: Mapping[str, Any], paths: LibraryPaths
) -> Iterator[Entry]:
    """The captures that a path stands for, absolute and with a name each."""
    settings = [*table.get("settings", ()), *changes.get("settings", ())]
    table = {**table, **changes, "settings": settings}
    masks = folder_of_masks(table.get("masks", ""), where)
    own_place = absolute(str(paths.root))
    for place in places(table["path"], where):
        if place == own_place:
            continue
        name = name_of_result(table.get("name", ""), place, where, paths)
        tags = table.get("tags", [])
        own = {
            "path": str(place),
            "name": name,
            "masks": masks,
            "catalogue": table.get("catalogue") or (tags[0] if tags else place.parent.name),
        }
        try:
            entry = settings_from_table(Entry, {**table, **own}, where)
            entry.config()
            if entry.memory:
                parse_size(entry.memory)
            AssetFacts(**entry.about)
        except ConfigError as error:
            place_of = f"{where}: " if where and not str(error).startswith(where) else ""
            raise ConfigError(f"{place_of}{error}") from error
        yield entry


def _refuse_twins(found: Sequence[tuple[str, Entry]]) -> None:
    seen: dict[str, Entry] = {}
    for where, entry in found:
        twin = seen.setdefault(key_of(entry.name), entry)
        if twin is not entry:
            raise UsageError(
                f"{where + ': ' if where else ''}{entry.path} and {twin.path} would both become "
                f"{entry.name!r}; give one of them another name in a plan"
            )


def _from(root: Path, entry: Entry) -> Entry:
    """The entry with paths from a folder."""
    table = table_from_settings(entry)
    for key in ("path", "masks"):
        if table[key]:
            table[key] = Path(table[key]).relative_to(root).as_posix()
    return settings_from_table(Entry, table, "")


@functools.cache
def _resolved(settings: tuple[str, ...]) -> RunConfig:
    return resolve(RunConfig(), None, settings)
