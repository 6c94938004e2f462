# SPDX-License-Identifier: Apache-2.0
"""Files that poses come in: JSON, XML, tables; and photographs named without their folder.

A reader says what values it expects as a `msgspec.Struct` or another type, and gets exactly that or
a refusal that names the file, the place in it and what is wrong there. Numbers of poses may be
infinite or none at all: those are named with their photographs later.
"""

from __future__ import annotations

import csv
import json
import os
import re
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Sequence
from itertools import takewhile
from pathlib import Path
from typing import Annotated, Any, TypeVar
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import msgspec
import numpy as np
from msgspec import Meta

from robir.capture.frames import IMAGE_SUFFIXES, MAX_NUMBER, Array
from robir.capture.refusal import CaptureRefusedError, refuse
from robir.jobs.names import open_regular, regular

Number = Annotated[float, Meta(ge=-MAX_NUMBER, le=MAX_NUMBER)]  # sane size
Positive = Annotated[float, Meta(gt=0, le=MAX_NUMBER)]  # a focal length or an angle
Side = Annotated[int, Meta(ge=1, le=1 << 20)]  # width or height of a picture in pixels
Identity = Annotated[str, Meta(min_length=1, max_length=64)]  # by which entries refer to each other
# a position, or three numbers that say how something is turned
Vector = Annotated[list[float], Meta(min_length=3, max_length=3)]
Turn = Annotated[list[Vector], Meta(min_length=3, max_length=3)]  # rows of a rotation
Point = Annotated[list[Number], Meta(min_length=2, max_length=2)]  # of a picture
Terms = Annotated[list[Number], Meta(max_length=64)]  # of a lens distortion
Nine = Annotated[list[Number], Meta(min_length=9, max_length=9)]  # a matrix of intrinsics
Sixteen = Annotated[list[float], Meta(min_length=16, max_length=16)]  # a pose, row by row
Matrix = list[list[float]]  # rows of a pose, whatever its numbers are worth
T = TypeVar("T")

_NAMES = {"float": "a number", "int": "a whole number", "str": "text", "array": "a list"}
_NAMES |= {"object": "a table", "null": "nothing", "bool": "true or false"}


def checked(
    path: Path,
    plain: Any,
    kind: type[T] | Any,
    cure: str,
    *,
    where: str = "",
    code: str = "bad-value",
    is_text: bool = False,
) -> T:
    """A value of a file, at `where`, of the type that msgspec is told, or a refusal with cure."""
    try:
        return msgspec.convert(plain, kind, strict=not is_text)
    except (msgspec.ValidationError, RecursionError) as fault:
        raise refuse(code, f"{path}: {_sentence(str(fault), where)}", cure, path.name) from None
    except UnicodeEncodeError:
        raise refuse(code, f"{path} holds text that is none", cure, path.name) from None


def missing_key(path: Path, key: str, where: str, cure: str) -> CaptureRefusedError:
    """The refusal for a key that is not there."""
    message = f'{path}: the key "{key}" is missing from {where}'
    return refuse("missing-key", message, cure, path.name)


def matrix_of(path: Path, rows: Matrix, what: str) -> Array:
    """A pose (4, 4) of three or four rows of four numbers, whatever these are worth."""
    if len(rows) not in (3, 4) or any(len(row) != 4 for row in rows):
        message = f"{path}: {what} is no 4x4 matrix of numbers"
        raise refuse("bad-pose", message, "Write four rows of four numbers.", path.name)
    return np.array([*rows[:3], [0.0, 0.0, 0.0, 1.0]])


def sane_points(plain: Any) -> Array:
    """Sparse points, (N, 3), of a list of positions; none if damaged, for they only help."""
    try:
        points = np.array(msgspec.convert(plain, list[Vector], strict=False), dtype=np.float64)
    except (msgspec.ValidationError, RecursionError, UnicodeEncodeError, OverflowError):
        return np.zeros((0, 3))
    points = points.reshape(-1, 3)
    return points[(np.abs(points) < MAX_NUMBER).all(axis=1)]


def _sentence(message: str, where: str) -> str:
    """Msgspec's message in our words."""
    fault, _, place = message.partition(" - at `$")
    above, _, key = place.rstrip("`").lstrip(".").rpartition(".")
    if missing := re.fullmatch(r"Object missing required field `(.*)`", fault):
        holder = ".".join(part for part in (above, key) if part)
        return f'the key "{missing[1]}" is missing from {holder or where or "the file"}'
    name, bracket, index = key.partition("[")
    name = f'"{name}"{bracket}{index}' if name else f"{bracket}{index}"
    above = re.sub(r"^(\w+)s\[(\d+)\]", r"\1 \2", above)
    whole = " of ".join(part for part in (name, above, where) if part)
    fault = re.sub(r" [<>]= -?1000000000000\.0$", " of sane size", fault)
    fault = re.sub(r"`([^`]*)`", lambda found: _kinds(found[1]), fault)
    return f"{whole or 'the file'}: {fault[:1].lower()}{fault[1:]}"


def _kinds(text: str) -> str:
    kinds = [kind.strip() for kind in text.split("|")]
    known = [_NAMES.get(kind, kind) for kind in kinds if kind != "null" or len(kinds) == 1]
    return " or ".join(known)


IMAGE_FOLDERS = ("images", "image", "input", "rgb", ".")  # likeliest first
MAX_VALUES_BYTES = 1 << 30  # memory that the values of a JSON file may come to
# what folders of other pictures are called, and what such pictures are called at the end
_OTHER_PICTURES = re.compile(
    r"mask|matte|alpha|segment|truth|depth|normal|thumb|confidence|albedo|roughness", re.IGNORECASE
)
_DEPTH = 3  # folders below the capture's own that are searched for photographs


def parsed(path: Path, parse: Callable[[str], T], kind: str, cure: str, code: str) -> T:
    """A text file of poses, UTF-8 with or without a mark at its beginning; or a refusal."""
    try:
        with regular(path) as file:
            return parse(file.read().decode("utf-8-sig"))
    except (OSError, ValueError, LookupError, RecursionError, SyntaxError, csv.Error) as fault:
        raise refuse(code, f"{path} is not readable as {kind} ({fault})", cure, path.name) from None


def load_json(path: Path) -> Any:
    """Content of a JSON file; whole numbers of absurd size as floating-point ones."""
    return parsed(path, _json, "JSON", "Write the file again.", "bad-json")


def _json(text: str) -> Any:
    # what Python needs for a table, a list and an entry of either
    if 240 * text.count("{") + 64 * text.count("[") + 60 * text.count(",") > MAX_VALUES_BYTES:
        raise ValueError("it holds too many values")
    return json.loads(text, parse_int=lambda word: int(word) if len(word) < 18 else float(word))


def load_xml(path: Path, cure: str) -> Element:
    """Root of an XML file."""
    return parsed(path, _xml, "XML", cure, "bad-xml")


def _xml(text: str) -> Element:
    if "<!DOCTYPE" in text:  # definitions could make it grow or read files; no export has any
        raise ValueError("it defines a document type")
    return ElementTree.fromstring(text)  # noqa: S314


def load_table(path: Path, cure: str) -> list[list[str]]:
    """Rows of a CSV file, blank ones left out, spaces around values too."""
    return parsed(path, _table, "a table of cameras", cure, "bad-table")


def _table(text: str) -> list[list[str]]:
    return [[word.strip() for word in row] for row in csv.reader(text.splitlines()) if row]


def head(path: Path, length: int = 65536) -> str:
    """The beginning of a text file, empty if there is none; for telling formats apart."""
    try:
        with os.fdopen(open_regular(path), "rb") as file:
            return file.read(length).decode("utf-8-sig", errors="replace")
    except OSError:
        return ""


def is_other(path: Path) -> bool:
    """Whether a folder's name says that it holds masks, depth or the like, no photographs."""
    return _OTHER_PICTURES.search(path.name) is not None


def without_others(pictures: Sequence[Path]) -> list[Path]:
    """Pictures whose names do not begin or end as those of masks or depth do; all if all do."""
    parts = [re.split("[_.-]", path.stem) for path in pictures]
    ends = [f"{words[0]} {words[-1]}" for words in parts]
    kept = [p for p, e in zip(pictures, ends, strict=True) if not _OTHER_PICTURES.search(e)]
    return kept or list(pictures)


def children(folder: Path) -> list[Path]:
    """What lies in a folder, by name, empty if unreadable; linked folders only of usual names."""
    try:
        with os.scandir(folder) as entries:
            found = sorted(
                entry.name
                for entry in entries
                if not (entry.is_symlink() and entry.is_dir() and entry.name not in IMAGE_FOLDERS)
            )
    except OSError:
        return []
    return [folder / name for name in found]


def pictures_in(folder: Path) -> list[Path]:
    """Pictures in a folder, sorted by name."""
    return [path for path in children(folder) if path.suffix.lower() in IMAGE_SUFFIXES]


def locate_photographs(poses: Path, names: Sequence[str]) -> tuple[Path, list[str]]:
    """Folder of the capture, and a path below it for each name that a file of poses gives.

    Names may lack folders and suffix. Photographs are searched below the file's folder, then beside
    and directly below that folder. Among several of a name, the one whose folders agree best with
    the name counts, then the one in the folder that has most of the names. What was not found
    stays as it is, in the folder `images`.
    """
    tails = [
        [part for part in name.replace("\\", "/").split("/") if part not in ("", ".", "..")]
        or ["unnamed"]
        for name in names
    ]
    best, root, found = -1, poses.parent, list[str | None]()
    for place, depth in ((poses.parent, _DEPTH), (poses.parent.parent, 1)):
        matches = _matches(list(_pictures(place, "", depth)), tails)
        count = sum(match is not None for match in matches)
        if count > best:
            best, root, found = count, place, matches
        if count == len(names):
            break
    missing = [f"{IMAGE_FOLDERS[0]}/{tail[-1]}" for tail in tails]
    return root, [match or lost for match, lost in zip(found, missing, strict=True)]


def _pictures(root: Path, below: str, depth: int) -> Iterator[str]:
    """Paths of pictures below a folder, "/" between folders."""
    for child in children(root / below):
        relative = f"{below}{child.name}"
        if child.suffix.lower() in IMAGE_SUFFIXES:
            yield relative
        elif depth > 0 and not (child.name.startswith(".") or is_other(child)) and child.is_dir():
            yield from _pictures(root, f"{relative}/", depth - 1)


def _matches(pictures: Sequence[str], tails: Sequence[Sequence[str]]) -> list[str | None]:
    by_name: dict[str, list[str]] = defaultdict(list)
    for picture in pictures:
        name = picture.lower().rsplit("/", 1)[-1]
        by_name[name].append(picture)
        by_name[name.rsplit(".", 1)[0]].append(picture)
    # a name may also carry the suffix of what the photograph was before a conversion
    lower = [tail[-1].lower() for tail in tails]
    candidates = [by_name.get(n) or by_name.get(n.rsplit(".", 1)[0], []) for n in lower]
    counts = Counter(picture.rpartition("/")[0] for some in candidates for picture in some)

    def rank(picture: str, tail: Sequence[str]) -> tuple[int, int, int, str]:
        folder = picture.rpartition("/")[0]
        usual = (folder or ".").rsplit("/", 1)[-1].lower()
        order = IMAGE_FOLDERS.index(usual) if usual in IMAGE_FOLDERS else len(IMAGE_FOLDERS)
        return (-_agreement(picture, tail), -counts[folder], order, picture)

    return [
        min(some, key=lambda picture, tail=tail: rank(picture, tail), default=None)
        for some, tail in zip(candidates, tails, strict=True)
    ]


def _agreement(picture: str, tail: Sequence[str]) -> int:
    """Folders that two paths have in common, counted from the name upwards."""
    pairs = zip(picture.lower().split("/")[-2::-1], tail[-2::-1], strict=False)
    return sum(1 for _ in takewhile(lambda pair: pair[0] == pair[1].lower(), pairs))
