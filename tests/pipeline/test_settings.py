# SPDX-License-Identifier: Apache-2.0
"""The one reader of settings: what it takes, what it refuses, and how it says so."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robir.errors import ConfigError
from robir.settings import (
    changed_settings,
    parse_assignment,
    read_toml,
    settings_from_table,
    table_from_settings,
    toml_from_settings,
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Inner:
    num_steps: int = 10
    learning_rate: float = 0.5
    is_fast: bool = False
    family: Literal["a", "b"] = "a"
    levels: tuple[int, ...] = (1, 2)
    pair: tuple[float, str] = (1.0, "x")
    note: str | None = None
    shares: tuple[float, float] = (0.2, 0.8)


@dataclass(frozen=True, slots=True, kw_only=True)
class Outer:
    seed: int = 0
    name: str = "n"
    inner: Inner = field(default_factory=Inner)


def read(**inner) -> Inner:
    return settings_from_table(Outer, {"inner": inner}, "file.toml").inner


@pytest.mark.parametrize(
    ("inner", "words"),
    [
        (
            {"learning_rate": "wide"},
            r"inner\.learning_rate is 'wide': it must be a number, got a string",
        ),
        (
            {"num_stps": 1},
            r"file\.toml: unknown setting 'inner\.num_stps'; did you mean 'num_steps'",
        ),
        ({"qqq": 1}, r"known here: num_steps, learning_rate"),
        (
            {"num_steps": True},
            r"num_steps is True: it must be a whole number, got true",
        ),
        ({"num_steps": 1.0}, "it must be a whole number, got a number"),
        ({"num_steps": "10"}, "is '10': it must be a whole number, got a string"),
        ({"learning_rate": "fast"}, "it must be a number"),
        ({"learning_rate": True}, "it must be a number"),
        ({"learning_rate": float("nan")}, "learning_rate is nan; it must be a finite number"),
        ({"shares": [0.5, float("inf")]}, "it must be a finite number"),
        ({"is_fast": 1}, "it must be true or false"),
        ({"family": "c"}, "choose one of 'a', 'b'"),
        ({"levels": 3}, "it must be a list"),
        ({"levels": [1, "2"]}, r"got a string - at `\$\[1\]`"),
        ({"pair": [1.0]}, "length 2, got 1"),
        ({"note": 3}, "it must be"),
    ],
)
def test_wrong_settings_are_refused_in_words(inner, words):
    with pytest.raises(ConfigError, match=words):
        read(**inner)


@pytest.mark.parametrize(
    ("text", "table"),
    [
        ("seed=3", {"seed": 3}),
        ("inner.learning_rate = 1e-3", {"inner": {"learning_rate": 1e-3}}),
        ("inner.is_fast=true", {"inner": {"is_fast": True}}),
        ("inner.family=b", {"inner": {"family": "b"}}),
        ("inner.levels=[1, 2]", {"inner": {"levels": [1, 2]}}),
        ('name="a=b"', {"name": "a=b"}),
    ],
)
def test_assignments_are_toml_or_bare_words(text, table):
    assert parse_assignment(text) == table


@pytest.mark.parametrize("text", ["seed", "=3", "inner..x=3", ""])
def test_what_is_no_assignment_is_refused(text):
    with pytest.raises(ConfigError, match=r"section\.key=value"):
        parse_assignment(text)


names = st.text(st.characters(codec="utf-8", exclude_categories=["Cs"]), max_size=8)


@given(
    steps=st.integers(-(2**62), 2**62),
    rate=st.floats(allow_nan=False, allow_infinity=False, allow_subnormal=False),
    levels=st.lists(st.integers(0, 99), max_size=4),
    note=st.none() | names,
    name=names,
)
def test_toml_round_trip(tmp_path_factory, steps, rate, levels, note, name):
    inner = Inner(num_steps=steps, learning_rate=rate, levels=tuple(levels), note=note)
    value = Outer(name=name, inner=inner)
    path = tmp_path_factory.mktemp("toml") / "config.toml"
    path.write_text(toml_from_settings(value), encoding="utf-8")
    assert settings_from_table(Outer, read_toml(path), str(path)) == value


def test_differences_are_told_by_dotted_name():
    before, after = (table_from_settings(Outer(seed=s, inner=Inner(num_steps=s))) for s in (1, 2))
    assert changed_settings(before, after) == ["inner.num_steps: 1 -> 2", "seed: 1 -> 2"]


def test_a_file_that_is_no_toml_is_refused(tmp_path):
    path = tmp_path / "broken.toml"
    path.write_text("[geometry\n")
    with pytest.raises(ConfigError, match=r"broken\.toml is not valid TOML"):
        read_toml(path)
    with pytest.raises(ConfigError, match="cannot read"):
        read_toml(tmp_path / "absent.toml")
