# SPDX-License-Identifier: Apache-2.0
"""Result files as checked values, with the standard library only, for Blender's Python reads them.

A form says what a file has to hold: a type (`float` takes whole numbers too, `Any` everything); a
tuple of forms, one of which has to fit; a list of one form, which every entry has to fit; a
dictionary of forms by key, where a key that ends in "?" may be missing and `...` stands for any
other key. What a form does not name is let pass.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from robir.jobs.names import read_regular

MAX_BYTES = 1 << 26  # largest JSON file of a result that is read; they have a few thousand bytes
NUMBERS = [float]
MATRIX = [NUMBERS]

# a view of capture.json or cameras.json
CAMERA = {
    "name": str, "split": str, "width": int, "height": int,
    "fx": float, "fy": float, "cx": float, "cy": float, "camera_to_world": MATRIX,
}  # fmt: skip
_NAMES = {str: "text", float: "a number", int: "a whole number", bool: "true or false"}
_NAMES |= {dict: "a table", list: "a list", type(None): "null"}


class DamagedFileError(ValueError):
    """A file of a result folder does not hold what it should; the message says where."""


def read_record(path: Path, form: Any) -> Any:
    """Contents of a JSON file that fit a form, all finite; else an `OSError` or `ValueError`."""
    content = read_regular(path, MAX_BYTES)
    try:
        value = json.loads(content.decode("utf-8"), parse_float=_finite, parse_constant=_finite)
        if b"\\u" in content:  # half of a pair of letters can only come by such a word
            json.dumps(value, ensure_ascii=False).encode("utf-8")
    except RecursionError:
        raise DamagedFileError(f"{path.name} is nested too deeply") from None
    check(value, form, path.name)
    return value


def _finite(text: str) -> float:
    number = float(text)
    if not math.isfinite(number):
        raise DamagedFileError(f"{text[:30]} is no number")
    return number


def check(value: Any, form: Any, where: str) -> None:
    """Refuse a plain value, called `where`, that does not fit a form (`DamagedFileError`)."""
    if isinstance(form, tuple):
        if not any(_fits(value, one) for one in form):
            raise DamagedFileError(f"{where} is {_named(value)}")
    elif isinstance(form, list):
        _expect(isinstance(value, list), value, list, where)
        for index, entry in enumerate(value):
            check(entry, form[0], f"{where}[{index}]")
    elif isinstance(form, Mapping):
        _check_table(value, form, where)
    elif form is None:
        _expect(value is None, value, type(None), where)
    elif form is not Any:
        _expect(_is_of(value, form), value, form, where)


def _check_table(value: Any, form: Mapping[Any, Any], where: str) -> None:
    _expect(isinstance(value, dict), value, dict, where)
    for key, inner in form.items():
        name = key if key is ... else key.removesuffix("?")
        if key is ...:
            for other in value.keys() - form.keys():
                check(value[other], inner, f"{where}.{other}")
        elif name in value:
            check(value[name], inner, f"{where}.{name}")
        elif name == key:
            raise DamagedFileError(f"{where} lacks {name!r}")


def _fits(value: Any, form: Any) -> bool:
    try:
        check(value, form, "")
    except DamagedFileError:
        return False
    return True


def _is_of(value: Any, kind: type) -> bool:
    if kind is float:
        is_number = isinstance(value, int | float) and not isinstance(value, bool)
        return is_number and abs(value) < 1e300  # a whole number may be too large for any use
    if kind is int:
        return isinstance(value, int) and not isinstance(value, bool) and abs(value) < 1 << 63
    return isinstance(value, kind)


def _expect(is_right: bool, value: Any, kind: type, where: str) -> None:
    if not is_right:
        wanted = _NAMES.get(kind, kind.__name__)
        raise DamagedFileError(f"{where} is {_named(value)} instead of {wanted}")


def _named(value: Any) -> str:
    if isinstance(value, float | int) and not isinstance(value, bool):
        return str(value)[:30] if abs(value) < 1e300 else "an absurd number"
    return _NAMES.get(type(value), type(value).__name__)
