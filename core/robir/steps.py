# SPDX-License-Identifier: Apache-2.0
"""Stages as lists of named steps, any of which on trial can be left out.

What a step is worth is measured by leaving it out: `robir bench --ablate` makes its runs from these
lists, and `--set appearance.without='["polish"]'` leaves a step out by hand.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from robir.errors import ConfigError

State = TypeVar("State")


@dataclass(frozen=True, slots=True, kw_only=True)
class Step(Generic[State]):
    """One step of a stage.

    Attributes:
        name: By which it is left out: words with hyphens, unique in its stage.
        purpose: What it is for, one line.
        source: Where the method is from, or "ours".
        run: Takes what is known and returns it with the step's part in it.
        is_on_trial: Whether the stage works without it.
    """

    name: str
    purpose: str
    source: str
    run: Callable[[State], State]
    is_on_trial: bool = True


def carry_out(steps: Sequence[Step[State]], state: State, without: Sequence[str] = ()) -> State:
    """Do one step after the other, but for those left out."""
    for step in steps:
        if step.name not in without:
            state = step.run(state)
    return state


def check_left_out(steps: Sequence[Step[Any]], without: Sequence[str], setting: str) -> None:
    """Refuse to leave out what is no step, or what the stage cannot do without.

    Args:
        steps: All of the stage.
        without: Names of those to be left out.
        setting: That names them, for the message.

    Raises:
        ConfigError: With the names that may stand there.
    """
    on_trial = [step.name for step in steps if step.is_on_trial]
    for name in without:
        if name not in on_trial:
            raise ConfigError(f"{setting}: {name!r} cannot be left out; {', '.join(on_trial)} can")
