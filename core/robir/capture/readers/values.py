# SPDX-License-Identifier: Apache-2.0
"""What a file of poses holds, as checked values: the one place where plain values become typed.

A reader says what it expects as a `msgspec.Struct` or another type, and gets exactly that or a
refusal that names the file, the place in it and what is wrong there. Numbers of poses may be
infinite or none at all: those are named with their photographs later.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated, Any, TypeVar

import msgspec
import numpy as np
from msgspec import Meta

from robir.capture.frames import MAX_NUMBER, Array
from robir.capture.refusal import CaptureRefusedError, refuse

# finite, of a size that a camera may have
Number = Annotated[float, Meta(ge=-MAX_NUMBER, le=MAX_NUMBER)]
Positive = Annotated[float, Meta(gt=0, le=MAX_NUMBER)]  # a focal length or an angle
Side = Annotated[int, Meta(ge=1, le=1 << 20)]  # width or height of a picture in pixels
# what entries of a file refer to each other by
Identity = Annotated[str, Meta(min_length=1, max_length=64)]
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
    """A value of a file of the type that msgspec is told, or a refusal with code and cure.

    `where` is its place in the file, empty for the whole of it; `is_text` that numbers are text.
    """
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
