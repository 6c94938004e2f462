# SPDX-License-Identifier: Apache-2.0
"""What a stage is handed when it runs."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Generic, Protocol, TypeVar

from robir.jobs.paths import JobPaths

ConfigT = TypeVar("ConfigT")


class Reporter(Protocol):
    """Where a stage says how far it is."""

    def progress(self, fraction: float, message: str) -> None:
        """Report a share in [0, 1] and what is being done; `CancelledError` if asked to stop."""

    def warn(self, message: str) -> None:
        """Tell the user something that lowers the result but does not stop the run."""

    def metric(self, name: str, value: Any) -> None:
        """Record a number worth following while the stage runs."""


@dataclass(frozen=True, slots=True, kw_only=True)
class StageContext(Generic[ConfigT]):
    """Everything a stage may depend on besides the files of the stages before it."""

    paths: JobPaths  # names of the result folder's files
    config: ConfigT  # the stage's own configuration
    source: Path  # capture as given by the user; read by the capture stage only
    masks: Path | None  # folder of masks given by the user, or None; read by the capture stage only
    seed: int  # seed of every random generator of the stage
    device: str  # torch device, "cpu" or "cuda"
    reporter: Reporter  # progress, warnings and the request to stop
    mesh: Path | None = None  # of the user; for the stages capture and geometry


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
