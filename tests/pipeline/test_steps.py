# SPDX-License-Identifier: Apache-2.0
"""Stages as lists of steps: what can be left out, what cannot, and that nothing else changes."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import pytest

from robir.appearance.stage import STEPS as APPEARANCE
from robir.errors import ConfigError
from robir.geometry.stage import STEPS as GEOMETRY
from robir.steps import Pipeline, Step, check_left_out

ADDING = (
    Step(name="one", purpose="-", source="-", run=lambda n: (*n, 1)),
    Step(name="two", purpose="-", source="-", run=lambda n: (*n, 2), is_on_trial=False),
    Step(name="three", purpose="-", source="-", run=lambda n: (*n, 3)),
)


def test_steps_follow_each_other_but_for_those_left_out():
    assert Pipeline().run(ADDING, ()) == (1, 2, 3)
    assert Pipeline(["three", "one"]).run(ADDING, ()) == (2,)


@dataclass(frozen=True, kw_only=True)
class Known:
    values: list[int]
    told: str = field(default="", compare=False)


def test_steps_that_change_nothing_are_told():
    steps = (
        Step(name="same", purpose="-", source="-", run=lambda state: state),
        Step(name="talks", purpose="-", source="-", run=lambda state: replace(state, told="so")),
        Step(name="works", purpose="-", source="-", run=lambda state: Known(values=[1])),
        Step(name="equal", purpose="-", source="-", run=lambda state: replace(state, values=[1])),
        Step(name="must", purpose="-", source="-", run=lambda state: state, is_on_trial=False),
    )
    pipeline = Pipeline(["equal"])
    ended = pipeline.run(steps, Known(values=[]))
    assert (ended.values, ended.told) == ([1], "")
    assert pipeline.idle(steps) == ["same", "talks", "equal"]
    told = pipeline.plain(steps)
    assert told["idle"] == pipeline.idle(steps)
    assert list(told["cpu_seconds"]) == ["same", "talks", "works", "must"]
    pipeline = Pipeline()
    pipeline.run(steps, pipeline.run(steps[3:], Known(values=[])))
    assert pipeline.idle(steps) == ["same", "talks"], "what changed something once is not idle"


@pytest.mark.parametrize("name", ["two", "four", ""])
def test_what_is_needed_or_unknown_cannot_be_left_out(name):
    with pytest.raises(ConfigError, match=r"appearance.without: .* cannot be left out; one, three"):
        check_left_out(ADDING, ["one", name], "appearance.without")


@pytest.mark.parametrize("steps", [GEOMETRY, APPEARANCE], ids=["geometry", "appearance"])
def test_names_are_unique_and_every_step_says_what_it_is_for(steps):
    names = [step.name for step in steps]
    assert len(set(names)) == len(names)
    assert all(step.purpose and step.source for step in steps)
    check_left_out(steps, [step.name for step in steps if step.is_on_trial], "-")
