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
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any, Literal, TypeVar, get_args, get_origin, get_type_hints

import msgspec

from robir.constants import of_setting
from robir.errors import ConfigError
from robir.jobs.names import read_regular

_MAX_BYTES = 1 << 20  # largest file of settings; all there are come to twenty thousand bytes

# settings of before by their names of today
_RENAMED = {
    "geometry.stereo.image_side": "geometry.stereo_side",
    "geometry.refine.image_sides": "geometry.refine_sides",
}

# what msgspec says of types, for users
_WORDS = {
    "Expected": "it must be",
    "`int`": "a whole number",
    "`float`": "a number",
    "`str`": "a string",
    "`bool`": "true or false",
    "`array`": "a list",
}

SettingsT = TypeVar("SettingsT")


def read_toml(path: Path) -> dict[str, Any]:
    """Read a TOML file; `ConfigError` if the file is missing or is not TOML."""
    try:
        return tomllib.loads(read_regular(path, _MAX_BYTES).decode("utf-8"))
    except OSError as error:
        raise ConfigError(f"cannot read the settings {path}: {error.strerror or error}") from error
    except (ValueError, RecursionError) as error:
        raise ConfigError(f"{path} is not valid TOML: {error}") from error


def parse_assignment(text: str) -> dict[str, Any]:
    """Table of one `section.key=value` from the command line.

    The value is TOML; a bare word that is not TOML is taken as a string. `ConfigError` if there is
    no `=` or no key before it.
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
    """Build a frozen settings dataclass from a nested table; absent fields keep their defaults.

    `source` is where the table comes from, for messages: a file name or "--set". `ConfigError` if a
    key is unknown, a value has the wrong type, or the class refuses it.
    """
    return _built(cls, checked_table(cls, table, source))


@functools.cache
def _hints(cls: type[Any]) -> dict[str, Any]:
    return get_type_hints(cls)


def checked_table(
    cls: type[Any], table: Mapping[str, Any], source: str, section: str = ""
) -> dict[str, Any]:
    """The table, section `section` of the whole, with every value of the annotated type.

    `ConfigError` if a key is unknown, or a value has the wrong type.
    """
    hints = _hints(cls)
    names = [field.name for field in fields(cls)]
    values: dict[str, Any] = {}
    for key, value in table.items():
        dotted = f"{section}.{key}" if section else key
        if key not in names:
            raise ConfigError(_unknown_key(dotted, value, names, source))
        hint = hints[key]
        if not is_dataclass(hint):
            values[key] = _converted(value, hint, dotted, source)
        elif isinstance(value, Mapping):
            values[key] = checked_table(hints[key], value, source, dotted)
        else:
            raise ConfigError(f"{source}: {dotted} is a section, not a value ({value!r})")
    return values


def table_from_settings(settings: Any) -> dict[str, Any]:
    """Nested plain values of a settings dataclass, as a JSON file has them: tuples are lists."""
    return msgspec.json.decode(msgspec.json.encode(settings))


def toml_from_settings(settings: Any) -> str:
    """TOML text that `settings_from_table` reads back to an equal value."""
    lines: list[str] = []
    _write_section(settings, "", lines)
    return "\n".join(lines).strip() + "\n"


def changed_settings(
    before: Mapping[str, Any], after: Mapping[str, Any], section: str = ""
) -> list[str]:
    """Sentences such as `geometry.rays: 900 -> 400` for every value that differs."""
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
    hints = _hints(cls)
    return cls(
        **{
            key: _built(hints[key], value) if isinstance(value, Mapping) else value
            for key, value in values.items()
        }
    )


def _unknown_key(dotted: str, value: Any, names: list[str], source: str) -> str:
    key, leaf = dotted.rpartition(".")[2], dotted
    while isinstance(value, Mapping) and value:
        name, value = next(iter(value.items()))
        leaf = f"{leaf}.{name}"
    if leaf in _RENAMED:
        return f"{source}: {leaf} is called {_RENAMED[leaf]} now; write that"
    constant = of_setting(leaf)
    if constant is not None:
        return (
            f"{source}: {leaf} is no setting any more; take it out (it is a constant, which "
            f"developers change by --constant {constant}=VALUE)"
        )
    close = difflib.get_close_matches(key, names, n=1, cutoff=0.5)
    hint = f"did you mean {close[0]!r}? " if close else ""
    return f"{source}: unknown setting {dotted!r}; {hint}known here: {', '.join(names)}"


def _converted(value: Any, hint: Any, dotted: str, source: str) -> Any:
    """The value as the annotated type, or ConfigError."""
    members = value if isinstance(value, list | tuple) else [value]
    try:
        if any(isinstance(one, float) and not _is_sane(one) for one in members):
            raise ConfigError(f"{source}: {dotted} is {value!r}; it must be a finite number")
        return msgspec.convert(value, hint)
    except msgspec.ValidationError as error:
        choices = _choices(hint)
        allowed = f"; choose one of {', '.join(map(repr, choices))}" if choices else ""
        text = str(error)
        for theirs, ours in _WORDS.items():
            text = text.replace(theirs, ours)
        raise ConfigError(f"{source}: {dotted} is {value!r}: {text}{allowed}") from error


def _choices(hint: Any) -> tuple[Any, ...]:
    """What a setting, or each member of a list, is chosen from; empty where that is free."""
    members = get_args(hint)
    if get_origin(hint) is Literal:
        return members
    return _choices(members[0]) if get_origin(hint) is tuple and members else ()


def _is_sane(value: float) -> bool:
    """Whether a number is finite, and so is what is divided by it."""
    return math.isfinite(value) and (value == 0 or abs(value) >= sys.float_info.min)


def _write_section(settings: Any, section: str, lines: list[str]) -> None:
    nested = [field for field in fields(settings) if is_dataclass(getattr(settings, field.name))]
    if section and len(nested) < len(fields(settings)):
        lines += ["", f"[{section}]"]
    for field in fields(settings):
        value = getattr(settings, field.name)
        if value is not None and field not in nested:
            lines.append(f"{field.name} = {_toml_value(value)}")
    for field in nested:
        name = f"{section}.{field.name}" if section else field.name
        _write_section(getattr(settings, field.name), name, lines)


def _toml_value(value: Any) -> str:
    if isinstance(value, tuple):
        return "[" + ", ".join(_toml_value(item) for item in value) + "]"
    if isinstance(value, float):
        return repr(value)
    # JSON's spelling is TOML's, but for surrogate pairs and the one control character JSON allows.
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
