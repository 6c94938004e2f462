# SPDX-License-Identifier: Apache-2.0
"""Stages as lists of steps: what can be left out, what cannot, and that nothing else changes."""

from __future__ import annotations

import pytest

from robir.appearance.stage import STEPS as APPEARANCE
from robir.errors import ConfigError
from robir.geometry.stage import STEPS as GEOMETRY
from robir.steps import Step, carry_out, check_left_out

ADDING = (
    Step(name="one", purpose="-", source="-", run=lambda n: (*n, 1)),
    Step(name="two", purpose="-", source="-", run=lambda n: (*n, 2), is_on_trial=False),
    Step(name="three", purpose="-", source="-", run=lambda n: (*n, 3)),
)


def test_steps_follow_each_other_but_for_those_left_out():
    assert carry_out(ADDING, ()) == (1, 2, 3)
    assert carry_out(ADDING, (), ["three", "one"]) == (2,)


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
