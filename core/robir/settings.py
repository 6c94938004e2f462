# SPDX-License-Identifier: Apache-2.0
"""Frozen dataclasses from TOML and back: one reader for files and for `--set`.

A setting is refused where it is unknown or of the wrong type; an integer is accepted for a float
and converted, so that equal settings have equal fingerprints. `None` has no spelling in TOML: an
optional setting that is absent is None.
"""

from __future__ import annotations

import difflib
import functools
import json
import math
import sys
import tomllib
import types
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path
from typing import (
    Annotated,
    Any,
    Literal,
    TypeVar,
    Union,
    get_args,
    get_origin,
    get_type_hints,
)

from robir.errors import ConfigError
from robir.jobs.names import read_regular

_MAX_BYTES = 1 << 20
"""Largest file of settings; all there are come to twenty thousand bytes."""

SettingsT = TypeVar("SettingsT")


@dataclass(frozen=True, slots=True)
class Within:
    """What a setting may be, beside its type: `reach: Annotated[float, Within(0, 1, "radians")]`.

    Of a tuple it holds for every member.

    Attributes:
        low: Least value allowed.
        high: Largest value allowed.
        unit: Of the value, empty for a count or a plain ratio.
    """

    low: float
    high: float
    unit: str = ""

    def __str__(self) -> str:
        """As it stands beside the value in a file of settings."""
        return f"{self.low:g} .. {self.high:g} {self.unit}".rstrip()


def read_toml(path: Path) -> dict[str, Any]:
    """Read a TOML file.

    Raises:
        ConfigError: If the file is missing or is not TOML.
    """
    try:
        return tomllib.loads(read_regular(path, _MAX_BYTES).decode("utf-8"))
    except OSError as error:
        raise ConfigError(f"cannot read the settings {path}: {error.strerror}") from error
    except (ValueError, RecursionError) as error:
        raise ConfigError(f"{path} is not valid TOML: {error}") from error


def parse_assignment(text: str) -> dict[str, Any]:
    """Table of one `section.key=value` from the command line.

    The value is TOML; a bare word that is not TOML is taken as a string.

    Raises:
        ConfigError: If there is no `=` or no key before it.
    """
    dotted, separator, value = text.partition("=")
    keys = dotted.strip().split(".")
    if not separator or not all(keys):
        raise ConfigError(f"--set {text!r} is not of the form section.key=value")
    try:
        table: dict[str, Any] = tomllib.loads(f"{keys[-1]} = {value}")
    except (ValueError, RecursionError):
        table = {keys[-1]: value.strip()}
    for key in reversed(keys[:-1]):
        table = {key: table}
    return table


def merge(base: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """Nested tables with the values of `changes` put over those of `base`."""
    merged = dict(base)
    for key, value in changes.items():
        below = merged.get(key)
        if isinstance(value, Mapping) and isinstance(below, Mapping):
            merged[key] = merge(below, value)
        else:
            merged[key] = value
    return merged


def settings_from_table(cls: type[SettingsT], table: Mapping[str, Any], source: str) -> SettingsT:
    """Build a settings dataclass from a nested table; absent fields keep their defaults.

    Args:
        cls: Frozen dataclass whose fields are plain values, tuples of them, or dataclasses;
            `Within` beside the type of a field is its range.
        table: Values by field name.
        source: Where the table comes from, for messages: a file name or "--set".

    Raises:
        ConfigError: If a key is unknown, a value has the wrong type or is out of its range, or the
            class refuses it.
    """
    return _built(cls, checked_table(cls, table, source))


@functools.cache
def _hints(cls: type[Any]) -> dict[str, Any]:
    return get_type_hints(cls, include_extras=True)


@functools.cache
def _plain_hints(cls: type[Any]) -> dict[str, Any]:
    return get_type_hints(cls)


def checked_table(
    cls: type[Any], table: Mapping[str, Any], source: str, section: str = ""
) -> dict[str, Any]:
    """The table with every value of the annotated type and in its range.

    What several fields must be together, their class says when it is built.

    Args:
        cls: As for `settings_from_table`.
        table: Values by field name.
        source: Where the table comes from, for messages.
        section: Dotted name of this table within the whole, empty for the root.

    Raises:
        ConfigError: If a key is unknown, or a value has the wrong type or is out of its range.
    """
    hints = _hints(cls)
    names = [field.name for field in fields(cls)]
    values: dict[str, Any] = {}
    for key, value in table.items():
        dotted = f"{section}.{key}" if section else key
        if key not in names:
            raise ConfigError(_unknown_key(dotted, key, names, source))
        hint = hints[key]
        if not is_dataclass(hint):
            values[key] = _converted(value, hint, dotted, source)
        elif isinstance(value, Mapping):
            values[key] = checked_table(hints[key], value, source, dotted)
        else:
            raise ConfigError(f"{source}: {dotted} is a section, not a value ({value!r})")
    return values


def table_from_settings(settings: Any) -> dict[str, Any]:
    """Nested plain values of a settings dataclass; tuples become lists."""
    return {field.name: _plain(getattr(settings, field.name)) for field in fields(settings)}


def toml_from_settings(settings: Any) -> str:
    """TOML text that `settings_from_table` reads back to an equal value.

    Where a field has a range, it stands beside the value.
    """
    lines: list[str] = []
    _write_section(settings, "", lines)
    return "\n".join(lines).strip() + "\n"


def changed_settings(
    before: Mapping[str, Any], after: Mapping[str, Any], section: str = ""
) -> list[str]:
    """Sentences such as `geometry.num_steps: 900 -> 400` for every value that differs."""
    sentences = []
    for key in sorted({*before, *after}):
        old, new = before.get(key), after.get(key)
        dotted = f"{section}.{key}" if section else key
        if isinstance(old, Mapping) and isinstance(new, Mapping):
            sentences += changed_settings(old, new, dotted)
        elif old != new:
            sentences.append(f"{dotted}: {old!r} -> {new!r}")
    return sentences


def _built(cls: type[SettingsT], values: Mapping[str, Any]) -> SettingsT:
    """The dataclass of checked values."""
    hints = _plain_hints(cls)
    return cls(
        **{
            key: _built(hints[key], value) if isinstance(value, Mapping) else value
            for key, value in values.items()
        }
    )


def _unknown_key(dotted: str, key: str, names: list[str], source: str) -> str:
    close = difflib.get_close_matches(key, names, n=1, cutoff=0.5)
    hint = f"did you mean {close[0]!r}? " if close else ""
    return f"{source}: unknown setting {dotted!r}; {hint}known here: {', '.join(names)}"


def _converted(value: Any, hint: Any, dotted: str, source: str) -> Any:
    """The value as the annotated type, or ConfigError."""
    origin = get_origin(hint)
    if origin is Annotated:
        inner, *notes = get_args(hint)
        return _in_range(_converted(value, inner, dotted, source), notes, dotted, source)
    if origin is Literal:
        if value in get_args(hint):
            return value
        allowed = ", ".join(repr(choice) for choice in get_args(hint))
        raise ConfigError(f"{source}: {dotted} is {value!r}; choose one of {allowed}")
    if origin in (Union, types.UnionType):
        inner = [choice for choice in get_args(hint) if choice is not type(None)]
        return None if value is None else _converted(value, inner[0], dotted, source)
    if origin is tuple:
        return _converted_tuple(value, get_args(hint), dotted, source)
    if hint is float and type(value) is int:
        return float(value)
    if type(value) is hint and (hint is not float or _is_sane(value)):
        return value
    raise ConfigError(
        f"{source}: {dotted} must be {_type_name(hint)}, found {value!r} ({type(value).__name__})"
    )


def _is_sane(value: float) -> bool:
    """Whether a number is finite, and so is what is divided by it."""
    return math.isfinite(value) and (value == 0 or abs(value) >= sys.float_info.min)


def _in_range(value: Any, notes: Sequence[Any], dotted: str, source: str) -> Any:
    """The value, each of its numbers within every range among the notes, or ConfigError."""
    ranges = [note for note in notes if isinstance(note, Within)]
    for number in value if isinstance(value, tuple) else (value,):
        for allowed in ranges:
            if not allowed.low <= number <= allowed.high:
                raise ConfigError(f"{source}: {dotted} is {value!r}; it must be in {allowed}")
    return value


def _converted_tuple(value: Any, members: tuple[Any, ...], dotted: str, source: str) -> Any:
    if not isinstance(value, list | tuple):
        raise ConfigError(f"{source}: {dotted} must be a list, found {value!r}")
    if len(members) == 2 and members[1] is Ellipsis:
        members = (members[0],) * len(value)
    if len(members) != len(value):
        raise ConfigError(f"{source}: {dotted} needs {len(members)} values, found {len(value)}")
    return tuple(
        _converted(item, member, f"{dotted}[{index}]", source)
        for index, (item, member) in enumerate(zip(value, members, strict=True))
    )


def _type_name(hint: Any) -> str:
    names = {
        bool: "true or false",
        int: "a whole number",
        float: "a finite number",
        str: "a string",
    }
    return names.get(hint, str(hint))


def _plain(value: Any) -> Any:
    if is_dataclass(value):
        return table_from_settings(value)
    if isinstance(value, tuple):
        return [_plain(item) for item in value]
    return value


def _write_section(settings: Any, section: str, lines: list[str]) -> None:
    hints = _hints(type(settings))
    nested = [field for field in fields(settings) if is_dataclass(getattr(settings, field.name))]
    if section and len(nested) < len(fields(settings)):
        lines += ["", f"[{section}]"]
    for field in fields(settings):
        value = getattr(settings, field.name)
        if value is not None and field not in nested:
            lines.append(f"{field.name} = {_toml_value(_plain(value))}{_beside(hints[field.name])}")
    for field in nested:
        name = f"{section}.{field.name}" if section else field.name
        _write_section(getattr(settings, field.name), name, lines)


def _beside(hint: Any) -> str:
    """Comment with the ranges that a type carries, else nothing."""
    ranges = [str(note) for note in getattr(hint, "__metadata__", ()) if isinstance(note, Within)]
    return f"  # {', '.join(ranges)}" if ranges else ""


def _toml_value(value: Any) -> str:
    if isinstance(value, list):
        return "[" + ", ".join(_toml_value(item) for item in value) + "]"
    if isinstance(value, float):
        return repr(value)
    # JSON's spelling is TOML's, but for surrogate pairs and the one control character JSON allows.
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
