# SPDX-License-Identifier: Apache-2.0
"""What may be done to a file: seeded damage, and values that no file should hold."""

from __future__ import annotations

import json
import os
import random
from pathlib import Path
from typing import Any

# values in place of others; each once ended in something else than a refusal, or may
NASTY: tuple[Any, ...] = (
    None, True, "", "x", [], {}, [[]], -1, 0, 1e308, 10**400, float("nan"), float("-inf"),
    "\ud800", "a\0b", "/", "/etc/passwd", "../../../../etc/passwd", "a" * 300, "²", "1_0", "٣",
    "..", [1, "a", None], "C:\\x\\y.png", "d/" * 3000, "a\nb", 2**63, ".png", [[0.0] * 4] * 500,
    "/dev/zero", "images/",
)  # fmt: skip

# contents in place of a whole file
WHOLE = (b"", b"\0" * 4096, b"\xff" * 4096, b"{}", b"[]", b"12", b"[" * 100_000, b'"x"', b"PK\3\4")


def flipped(content: bytes, generator: random.Random) -> bytes:
    """A few bytes changed, and sometimes the end cut off."""
    damaged = bytearray(content)
    for _ in range(generator.randint(1, 6)):
        if damaged:
            damaged[generator.randrange(len(damaged))] = generator.randrange(256)
    if generator.random() < 0.3:
        damaged = damaged[: generator.randrange(len(damaged) + 1)]
    return bytes(damaged)


def places(value: Any, at: tuple = ()) -> list[tuple]:
    """Keys that lead to each value of a JSON document; of lists the first and the last entry."""
    if isinstance(value, dict):
        inner = [(*at, key) for key in value]
    elif isinstance(value, list) and value:
        inner = [(*at, index) for index in sorted({0, len(value) - 1})]
    else:
        return []
    return inner + [deeper for one in inner for deeper in places(_at(value, one[len(at) :]), one)]


def replaced(document: Any, place: tuple, value: Any) -> str:
    """The document as text, with another value at a place; `...` leaves the place out."""
    copy = json.loads(json.dumps(document))
    holder = _at(copy, place[:-1])
    if value is ...:
        del holder[place[-1]]
    else:
        holder[place[-1]] = value
    return json.dumps(copy)


def _at(value: Any, place: tuple) -> Any:
    for key in place:
        value = value[key]
    return value


def damage_file(path: Path, generator: random.Random) -> None:
    """Do one of many things to a file."""
    content = path.read_bytes() if path.is_file() else b""
    kind = generator.randrange(10)
    if kind < 4 and path.suffix in (".json", ".sfm"):
        try:
            document = json.loads(content)
            place = generator.choice(places(document))
            path.write_text(replaced(document, place, generator.choice([*NASTY, ...])))
        except (ValueError, IndexError):
            pass
        return
    if kind < 7:
        path.write_bytes(flipped(content, generator))
        return
    if kind == 7:
        path.write_bytes(generator.choice(WHOLE))
        return
    path.unlink()
    match generator.randrange(5):
        case 0:
            path.mkdir()
        case 1:
            os.mkfifo(path)
        case 2:
            path.symlink_to("/dev/zero")
        case 3:
            path.symlink_to(path.name)
