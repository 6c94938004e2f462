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
from msgspec import Meta

from robir.capture.frames import MAX_NUMBER
from robir.capture.refusal import CaptureRefusedError, refuse

# finite, of a size that a camera may have
Number = Annotated[float, Meta(ge=-MAX_NUMBER, le=MAX_NUMBER)]
Positive = Annotated[float, Meta(gt=0, le=MAX_NUMBER)]  # a focal length or an angle
Side = Annotated[int, Meta(ge=1, le=1 << 20)]  # width or height of a picture in pixels
# what entries of a file refer to each other by
Identity = Annotated[str, Meta(min_length=1, max_length=64)]
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
    """A value of a file, if it is of the expected kind, or a refusal.

    Args:
        path: File it comes from.
        plain: As read: dictionaries, lists, text, numbers.
        kind: Type that is expected, as msgspec knows it.
        cure: What to do if it is not.
        where: Place in the file; empty for the whole of it.
        code: Code of the refusal.
        is_text: Whether the file writes numbers as text.
    """
    try:
        return msgspec.convert(plain, kind, strict=not is_text)
    except (msgspec.ValidationError, RecursionError) as fault:
        raise refuse(code, f"{path}: {_sentence(str(fault), where)}", cure, path.name) from None
    except UnicodeEncodeError:
        raise refuse(code, f"{path} holds text that is none", cure, path.name) from None


def missing_key(path: Path, key: str, where: str, cure: str) -> CaptureRefusedError:
    """The refusal for a key that is not there."""
    return refuse(
        "missing-key", f'{path}: the key "{key}" is missing from {where}', cure, path.name
    )


def _sentence(message: str, where: str) -> str:
    """Msgspec's message in our words."""
    said, _, place = message.partition(" - at `$")
    above, _, key = place.rstrip("`").lstrip(".").rpartition(".")
    if missing := re.fullmatch(r"Object missing required field `(.*)`", said):
        holder = ".".join(part for part in (above, key) if part)
        return f'the key "{missing[1]}" is missing from {holder or where or "the file"}'
    name, bracket, index = key.partition("[")
    name = f'"{name}"{bracket}{index}' if name else f"{bracket}{index}"
    above = re.sub(r"^(\w+)s\[(\d+)\]", r"\1 \2", above)
    whole = " of ".join(part for part in (name, above, where) if part)
    said = re.sub(r" [<>]= -?1000000000000\.0$", " of sane size", said)
    said = re.sub(r"`([^`]*)`", lambda found: _kinds(found[1]), said)
    return f"{whole or 'the file'}: {said[:1].lower()}{said[1:]}"


def _kinds(text: str) -> str:
    kinds = [kind.strip() for kind in text.split("|")]
    known = [_NAMES.get(kind, kind) for kind in kinds if kind != "null" or len(kinds) == 1]
    return " or ".join(known)
