# SPDX-License-Identifier: Apache-2.0
"""Constants of modules, changed by name for one run: how the bench sweeps what is no setting.

`geometry.ground.plane._TRIALS=900` is `_TRIALS = 900` in `robir/geometry/ground/plane.py`, as long
as the run lasts. A module reads its constants when they are needed, so that a change takes effect:
never in the default of an argument or in another constant.
"""

from __future__ import annotations

import importlib
import re
import sys
import tomllib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from difflib import SequenceMatcher, get_close_matches
from pathlib import Path
from types import ModuleType
from typing import Any

import msgspec

from robir.errors import ConfigError

_ROOT = Path(__file__).parent

applied: list[str] = []  # what is changed now, for a process that this one starts


def of_stage(changes: Sequence[str], stage: str, stages: Sequence[str]) -> list[str]:
    """The changes that a stage's fingerprint has, in one order.

    What is in none of the `stages`' rooms belongs to the first.
    """
    rooms = {change: change.partition(".")[0] for change in changes}
    owners = {c: room if room in stages else stages[0] for c, room in rooms.items()}
    return sorted(change for change in changes if owners[change] == stage)


def of_setting(dotted: str) -> str | None:
    """The constant that a setting of before has become, such as `geometry.ground.plane._TRIALS`."""
    name = dotted.rpartition(".")[2].upper()
    found = [
        f"{module}.{match[1]}"
        for module, file in _modules().items()
        if module.partition(".")[0] == dotted.partition(".")[0]
        for match in re.finditer(rf"^(_?{name}) =", file.read_text(encoding="utf-8"), re.MULTILINE)
    ]
    return max(found, key=lambda one: SequenceMatcher(None, one, dotted).ratio(), default=None)


@contextmanager
def changed(changes: Sequence[str]) -> Iterator[None]:
    """Change constants for the length of the block, by items "module.NAME=value".

    That is the module's dotted name below `robir`, and the value in TOML. `ConfigError` if there is
    no such module or constant, or the value has another type.
    """
    before: list[tuple[ModuleType, str, Any]] = []
    try:
        for change in changes:
            module, name, value = _read(change)
            for user in _users(module, name):
                before.append((user, name, getattr(user, name)))
                setattr(user, name, value)
            applied.append(change)
        yield
    finally:
        for user, name, value in reversed(before):
            setattr(user, name, value)
        applied.clear()


def _read(change: str) -> tuple[ModuleType, str, Any]:
    """Module, name and new value of one change."""
    path, _, text = change.partition("=")
    dotted, _, name = path.strip().rpartition(".")
    if dotted not in _modules():
        near = _near(dotted, list(_modules()))
        raise ConfigError(f"--constant {change!r}: no module {dotted!r}{near}")
    module = importlib.import_module(f"robir.{dotted}")
    names = [one for one in vars(module) if one.isupper() and _is_defined(module, one)]
    if name not in names:
        raise ConfigError(f"--constant {change!r}: {dotted} has no {name!r}{_near(name, names)}")
    try:
        value = tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        raise ConfigError(f"--constant {change!r}: {text!r} is no value of TOML") from None
    return module, name, _like(getattr(module, name), value, change)


def _modules() -> dict[str, Path]:
    """Files by the dotted name below `robir`."""
    files = sorted(_ROOT.rglob("*.py"))
    return {".".join(file.relative_to(_ROOT).with_suffix("").parts): file for file in files}


def _like(old: Any, new: Any, change: str) -> Any:
    """A new value as the old one's type."""
    kind = tuple[type(old[0]), ...] if isinstance(old, tuple) and old else type(old)
    try:
        return msgspec.convert(new, kind)
    except (msgspec.ValidationError, TypeError) as error:
        raise ConfigError(f"--constant {change!r}: the constant is {old!r}; {error}") from None


def _users(module: ModuleType, name: str) -> list[ModuleType]:
    """A constant's module, and those loaded ones that have imported it by name."""
    old = getattr(module, name)
    others = [one for key, one in sys.modules.items() if key.startswith("robir")]
    same = [one for one in others if vars(one).get(name) is old and not _is_defined(one, name)]
    return [module, *same]


def _is_defined(module: ModuleType, name: str) -> bool:
    """Whether a module's text itself gives a name its value."""
    text = Path(str(module.__file__)).read_text(encoding="utf-8")
    return re.search(rf"^{name}\b[^=\n]*=", text, re.MULTILINE) is not None


def _near(name: str, known: Sequence[str]) -> str:
    close = get_close_matches(name, known, n=3, cutoff=0.5)
    return f"; did you mean {' or '.join(close)}?" if close else ""
