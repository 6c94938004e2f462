# SPDX-License-Identifier: Apache-2.0
"""One row of the report's table of choices."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any


@dataclass(frozen=True, slots=True, kw_only=True)
class Choice:
    """What the model is made of in one respect, and why."""

    choice: str  # what there was to choose
    chosen: str | float  # what was taken
    alternatives: tuple[str | float, ...]  # what else there was
    why: str  # the rule with its figures, in words
    held_out_error: float | None = None  # on data held out, where that decided
    cost_seconds: float | None = None  # processor time of the choice, where it was measured

    def plain(self) -> dict[str, Any]:
        """As JSON has it."""
        return asdict(self)
