# SPDX-License-Identifier: Apache-2.0
"""Kills over a whole batch: `python -m tests.batch.kills COUNT [CAPTURES] [SEED]`.

At random moments the batch, one of its workers with or without what it started, or all of them are
killed, and the batch is started again with --resume. In the end every result has to be there and
the same as without a kill, no stage may have been finished twice, and what a page called done in
between has to be whole.
"""

from __future__ import annotations

import json
import os
import random
import re
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path

from hostile.tiny_run import RENDERS, contents

from robir.jobs.folder import holder
from robir.jobs.library import LibraryPaths
from robir.jobs.paths import STAGES
from robir.specimen import SETTINGS, write_specimen

# seconds of the processor, with all that a real run does
LEAST = (
    *(item for item in SETTINGS if not item.startswith("export.")),
    *RENDERS, "geometry.level_steps=[40]", 'appearance.families=["standard"]',
    "appearance.iterations=20", "appearance.texture_size=64", "transport.num_directions=64",
)  # fmt: skip

KINDS = ("batch", "worker", "worker and its own", "all")


class Range:
    """Captures, their unbroken results, and a batch that is killed."""

    def __init__(
        self, plan: Path, library: LibraryPaths, expected: Mapping[str, dict[str, str]]
    ) -> None:
        """Begin nothing yet.

        Args:
            plan: Of the batch.
            library: That the batch makes.
            expected: What `contents` says of each result as no kill leaves it, by name.
        """
        self.plan, self.library, self.expected = plan, library, expected

    def begin(self) -> subprocess.Popen[bytes]:
        """Start the batch, or go on with it, two at a time."""
        source = "--resume" if self.library.plan.exists() else str(self.plan)
        command = [sys.executable, "-P", "-m", "robir", "batch", source, "--jobs", "2"]
        return subprocess.Popen(
            [*command, "-o", str(self.library.root)],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )

    def differing(self) -> list[str]:
        """Files of results that are not as they have to be."""
        return [file for name in self.expected for file in self._differing(name)]

    def _differing(self, name: str) -> list[str]:
        found, expected = contents(self.library.result(name).root), self.expected[name]
        files = sorted(found.keys() | expected.keys())
        return [f"{name}/{file}" for file in files if found.get(file) != expected.get(file)]

    def workers(self) -> list[int]:
        locks = [self.library.result(name).lock for name in self.expected]
        return [pid for lock in locks if (pid := holder(lock))]

    def kill(self, process: subprocess.Popen[bytes], kind: str, generator: random.Random) -> None:
        """Kill what a kind names."""
        workers = self.workers()
        if kind in ("batch", "all"):
            process.kill()
            process.wait()
        chosen = workers if kind == "all" else generator.sample(workers, min(1, len(workers)))
        for pid in chosen if kind != "batch" else ():
            with suppress(ProcessLookupError):
                if kind == "worker":
                    os.kill(pid, signal.SIGKILL)
                else:
                    os.killpg(pid, signal.SIGKILL)

    def listed_wrongly(self) -> list[str]:
        """Files that are not as they have to be, of captures that the page calls done."""
        if not self.library.page.exists():
            return []
        found = re.findall(
            r'<article class="(\w+)".*?data-name="(\w+)"', self.library.page.read_text()
        )
        done = [name for state, name in found if state in ("done", "doubtful")]
        return [file for name in done for file in self._differing(name)]

    def finished_twice(self) -> list[str]:
        """Stages that were done more than once."""
        twice = []
        for name in self.expected:
            lines = self.library.result(name).events.read_text().splitlines()
            events = [json.loads(line) for line in lines if line.endswith("}")]
            ends = Counter(e["stage"] for e in events if e["kind"] == "finished")
            twice += [f"{name}: {stage}" for stage in STAGES if ends[stage] > 1]
        return twice


def unbroken(folder: Path, count: int) -> Range:
    """Captures of small spheres, and the library that no kill disturbs."""
    for number in range(count):
        write_specimen(folder / "shots" / f"sphere_{number}")
    plan = folder / "plan.toml"
    plan.write_text(f"settings = {json.dumps(LEAST)}\n[[capture]]\npath = 'shots/*'\n")
    whole = LibraryPaths(folder / "whole")
    Range(plan, whole, {}).begin().wait()
    names = [f"sphere_{number}" for number in range(count)]
    expected = {name: contents(whole.result(name).root) for name in names}
    return Range(plan, LibraryPaths(folder / "library"), expected)


def main() -> int:
    """Kill and compare; returns the number of faults."""
    count, captures, seed = (*map(int, sys.argv[1:]), *(20, 8, 0)[len(sys.argv) - 1 :])
    generator, faults = random.Random(seed), 0
    with tempfile.TemporaryDirectory(prefix="robir-batch-") as folder:
        begin = time.monotonic()
        shots = unbroken(Path(folder), captures)
        seconds = time.monotonic() - begin
        print(f"unbroken: {seconds:.0f} s for {captures} captures", flush=True)
        process, left = shots.begin(), count
        while left:
            time.sleep(generator.uniform(0.5, 2.0 * seconds / count))
            if process.poll() is not None:
                break
            kind = generator.choice(KINDS)
            shots.kill(process, kind, generator)
            left -= 1
            wrong = shots.listed_wrongly()
            faults += len(wrong)
            print(f"{count - left}: {kind}; listed wrongly: {wrong}", flush=True)
            if process.poll() is not None:
                process = shots.begin()
        code = process.wait()
        for _ in range(2):  # one whose two tries were killed is done by the next start
            code = shots.begin().wait()
        differing, twice = shots.differing(), shots.finished_twice()
        faults += len(differing) + len(twice)
        print(f"{count - left} kills, code {code}; differing: {differing}; done twice: {twice}")
    return min(faults, 100)


if __name__ == "__main__":
    sys.exit(main())
