# SPDX-License-Identifier: Apache-2.0
"""One row of the report's table of choices."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any


@dataclass(frozen=True, slots=True, kw_only=True)
class Choice:
    """What the model is made of in one respect, and why.

    Attributes:
        choice: What there was to choose.
        chosen: What was taken.
        alternatives: What else there was.
        why: The rule with its figures, in words.
        held_out_error: Of what was taken, on data that it was not fitted to, where that decided.
        cost_seconds: Processor time of the choice, where it was measured.
    """

    choice: str
    chosen: str | float
    alternatives: tuple[str | float, ...]
    why: str
    held_out_error: float | None = None
    cost_seconds: float | None = None

    def plain(self) -> dict[str, Any]:
        """As JSON has it."""
        return asdict(self)
