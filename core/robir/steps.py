# SPDX-License-Identifier: Apache-2.0
"""Stages as lists of named steps, any of which on trial can be left out.

What a step is worth is measured by leaving it out: `robir bench --ablate` makes its runs from these
lists, and `--set appearance.without='["polish"]'` leaves a step out by hand.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, fields, is_dataclass
from typing import Any, Generic, TypeVar

from robir.errors import ConfigError

State = TypeVar("State")


@dataclass(frozen=True, slots=True, kw_only=True)
class Step(Generic[State]):
    """One step of a stage."""

    name: str  # by which it is left out: words with hyphens, unique in its stage
    purpose: str  # what it is for, one line
    source: str  # where the method is from, or "ours"
    run: Callable[[State], State]  # takes what is known and returns it with the step's part in it
    is_on_trial: bool = True  # whether the stage works without it


# takes what is known after a step and returns it with something put right
Correction = Callable[[Any], Any]

_corrections: dict[str, Correction] = {}


@contextmanager
def corrected(by_step: Mapping[str, Correction]) -> Iterator[None]:
    """Let a bench put right what steps of these names found, for all runs within."""
    _corrections.update(by_step)
    try:
        yield
    finally:
        for name in by_step:
            del _corrections[name]


class Pipeline:
    """One run through a stage's steps but those `without`.

    `changed` are names of those that changed anything, `seconds` is the processor time of each so
    far, of all its rounds, by name.
    """

    def __init__(self, without: Sequence[str] = ()) -> None:
        self._without = without
        self.changed: set[str] = set()
        self.seconds: dict[str, float] = {}

    def run(self, steps: Sequence[Step[State]], state: State) -> State:
        """Do one step after the other, but for those left out."""
        for step in steps:
            if step.name not in self._without:
                started = time.process_time()
                before = state  # that of the step before is let go first
                state = step.run(before)
                if step.name in _corrections:
                    state = _corrections[step.name](state)
                spent = time.process_time() - started
                self.seconds[step.name] = self.seconds.get(step.name, 0.0) + spent
                if not _is_same(before, state):
                    self.changed.add(step.name)
        return state

    def idle(self, steps: Sequence[Step[Any]]) -> list[str]:
        """Names of those on trial that changed nothing: a run without them is this one."""
        on_trial = (step.name for step in steps if step.is_on_trial)
        return [name for name in on_trial if name not in self.changed]

    def plain(self, steps: Sequence[Step[Any]]) -> dict[str, Any]:
        """As plain values: "idle" names, and "cpu_seconds" by name."""
        return {
            "idle": self.idle(steps),
            "cpu_seconds": {name: round(spent, 3) for name, spent in self.seconds.items()},
        }


def _is_same(before: Any, after: Any) -> bool:
    """Whether a step found nothing to do: all that is compared is the very same objects."""
    if before is after or not is_dataclass(before):
        return before is after
    compared = (field.name for field in fields(before) if field.compare)
    return all(getattr(before, name) is getattr(after, name) for name in compared)


def check_left_out(steps: Sequence[Step[Any]], without: Sequence[str], setting: str) -> None:
    """Refuse to leave out what is no step, or what the stage cannot do without.

    `ConfigError` with the names that may stand there.
    """
    on_trial = [step.name for step in steps if step.is_on_trial]
    for name in without:
        if name not in on_trial:
            raise ConfigError(f"{setting}: {name!r} cannot be left out; {', '.join(on_trial)} can")
