# SPDX-License-Identifier: Apache-2.0
"""Five small stages that do what real ones do to files: read the ones before, write some, die.

Each writes a few arrays that depend on the seed and on everything upstream, with pauses, so that a
process can be killed between any two files. Run as a program it is the process to be killed.
"""

from __future__ import annotations

import hashlib
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from robir.config import RunConfig
from robir.jobs.context import StageContext
from robir.jobs.paths import STAGES, JobPaths, replacing, write_json
from robir.pipeline.device import Execution
from robir.pipeline.runner import RunRequest, reconstruct

NUM_FILES = 4


def nothing(_context: StageContext[Any]) -> None:
    """What a well-behaved stage does in between."""


@dataclass
class FakeStage:
    """Stands for the module `robir.<name>.stage`."""

    name: str  # stage
    pause: float = 0.0  # seconds before each file
    mischief: Callable[[StageContext[Any]], Any] = nothing  # called in the middle of the stage
    REVISION: int = 1
    calls: int = field(default=0)  # how often the stage ran
    metrics: Mapping[str, Any] = field(default_factory=dict)  # what its manifest says beside a mean

    def run(self, context: StageContext[Any]) -> Mapping[str, Any]:
        """Write arrays that depend on all that a stage may depend on."""
        self.calls += 1
        digest = hashlib.sha256(f"{self.name} {context.config} {context.seed}".encode())
        digest.update(b"".join(_upstream(context.paths, self.name)))
        digest.update(np.random.random(2).tobytes())
        generator = np.random.default_rng(list(digest.digest()))
        for index in range(NUM_FILES):
            context.reporter.progress(index / NUM_FILES, f"file {index}")
            time.sleep(self.pause)
            if index == NUM_FILES // 2:
                self.mischief(context)
            with (
                replacing(context.paths.stage(self.name) / f"{index}.npz") as temporary,
                temporary.open("wb") as file,
            ):
                np.savez(file, values=generator.random(64))
        if self.name == "export":
            write_json(context.paths.export / "light.json", generator.random(3).tolist())
            context.paths.report.parent.mkdir(parents=True, exist_ok=True)
            context.paths.report.write_text("report")
        return {"mean": float(generator.random())} | self.metrics


def _upstream(paths: JobPaths, stage: str) -> list[bytes]:
    before = STAGES[: STAGES.index(stage)]
    return [
        np.load(path)["values"].tobytes()
        for name in before
        for path in sorted(paths.stage(name).glob("*.npz"))
    ]


def fake_stages(pause: float = 0.0) -> dict[str, FakeStage]:
    """One well-behaved fake for every stage."""
    return {name: FakeStage(name=name, pause=pause) for name in STAGES}


class Silent:
    """A display that remembers."""

    def __init__(self) -> None:
        self.events: list[dict[str, Any]] = []

    def event(self, event: dict[str, Any], fraction: float, seconds_left: float | None) -> None:
        assert 0.0 <= fraction <= 1.0
        self.events.append(event)


def request(source: Path, out: Path, *, is_resume: bool = False, **changes: Any) -> RunRequest:
    """A request with small defaults."""
    values = {"masks": None, "config": RunConfig()} | changes
    execution = Execution(device="cpu", threads=1)
    return RunRequest(source=source, out=out, execution=execution, is_resume=is_resume, **values)


def make_capture(folder: Path, content: str = "{}") -> Path:
    """A capture as far as the runner can tell."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "transforms_train.json").write_text(content)
    (folder / "r_0.png").write_bytes(b"not read by the fakes")
    return folder


if __name__ == "__main__":
    reconstruct(
        request(Path(sys.argv[1]), Path(sys.argv[2]), is_resume=True),
        Silent(),
        fake_stages(pause=float(sys.argv[3])),
    )
