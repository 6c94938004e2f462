# SPDX-License-Identifier: Apache-2.0
"""Kills at random moments over all stages: `python -m hostile.kills COUNT [SEED]`.

Each run is killed once, every third one again while it goes on, and then goes on to its end. Every
second time Blender and other children outlive the process that started them. Every file of the
result has to be the same as without a kill, times apart.
"""

from __future__ import annotations

import os
import random
import shutil
import signal
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from hostile.tiny_run import begun, contents, ended, scenes, words

from robir.jobs.paths import STAGES, JobPaths
from robir.specimen import write_specimen

KEEP = os.environ.get("ROBIR_KEEP", "")  # folder for what differs; empty to throw it away


@dataclass(frozen=True, slots=True)
class Kill:
    """What became of a run that was killed."""

    seconds: float  # when it was killed
    stage: str  # first stage that was not done then
    out: Path  # the result after it had gone on to its end
    code: int  # exit code of that end
    differing: tuple[str, ...]  # names of files that differ from the unbroken result


class Range:
    """A capture, its unbroken result, and runs that are killed."""

    def __init__(self, folder: Path, *, has_renders: bool) -> None:
        """Render the capture and make the unbroken result."""
        self._folder, self._has_renders = folder, has_renders
        self._capture = folder / "capture"
        folder.mkdir(exist_ok=True)
        write_specimen(self._capture)
        self.log = folder / "log.txt"
        start = time.monotonic()
        self.code = self._run("whole")
        assert self.code in (0, 5), self.log.read_text()
        self.seconds = time.monotonic() - start
        self.whole = self._out("whole")
        self.expected = contents(self.whole)

    def _out(self, name: str) -> Path:
        """All results bear the same name, for the asset does so, too."""
        return self._folder / name / "out"

    def _begin(self, name: str) -> int:
        self._out(name).parent.mkdir(exist_ok=True)
        command = words(self._capture, self._out(name), has_renders=self._has_renders)
        return begun(command, self.log)

    def _run(self, name: str) -> int:
        return ended(self._begin(name))

    def kill(self, name: str, seconds: float, *, is_group: bool, again: float = 0.0) -> Kill:
        """Run, kill after some seconds, perhaps once more, and go on to the end.

        A run that was faster than that begins anew and is killed earlier.
        """
        out = self._out(name)
        while not self._killed(name, seconds, is_group):
            shutil.rmtree(out)
            seconds *= 0.8
        stage = next((s for s in STAGES if not JobPaths(out).manifest(s).exists()), "the end")
        if again:
            self._killed(name, again, is_group)
        code = self._run(name)
        found = contents(out)
        names = sorted(found.keys() | self.expected.keys())
        differing = tuple(n for n in names if found.get(n) != self.expected.get(n))
        return Kill(seconds, stage, out, code, differing)

    def _killed(self, name: str, seconds: float, is_group: bool) -> bool:
        """Begin and kill; whether it was still at work."""
        process = self._begin(name)
        time.sleep(seconds)
        with suppress(ProcessLookupError):
            (os.killpg if is_group else os.kill)(process, signal.SIGKILL)
        return ended(process) == -signal.SIGKILL

    def kills(self, count: int, seed: int) -> Iterator[Kill]:
        """Kills spread evenly over the time of a run, each at a random moment of its part."""
        generator = random.Random(seed)
        for index in range(count):
            first = (index + generator.random()) / count * self.seconds
            again = generator.random() * self.seconds / 2 if index % 3 == 2 else 0.0
            yield self.kill(str(index), first, is_group=bool(index % 2), again=again)


def main() -> int:
    """Kill and compare; returns the number of results that differ."""
    count, seed = int(sys.argv[1]), int(sys.argv[2]) if len(sys.argv) > 2 else 0
    with tempfile.TemporaryDirectory(prefix="robir-kills-") as folder:
        Range(Path(folder, "warm"), has_renders=True)  # reads what a first run has to read
        shots = Range(Path(folder), has_renders=True)
        print(f"unbroken: {shots.seconds:.1f} s, {len(shots.expected)} files", flush=True)
        bad = 0
        for number, kill in enumerate(shots.kills(count, seed)):
            names = list(kill.differing)
            if len(set(scenes([shots.whole, kill.out]))) > 1:
                names.append("what scene.blend says")
            is_same = kill.code == shots.code and not names
            bad += not is_same
            said = "same" if is_same else f"DIFFERS, code {kill.code}: {names}"
            print(f"{number}: {kill.seconds:5.1f} s, {kill.stage}: {said}", flush=True)
            if is_same:
                shutil.rmtree(kill.out)
            elif KEEP:
                shutil.copytree(folder, KEEP, dirs_exist_ok=True)
        print(f"{count - bad} of {count} results equal the unbroken one")
    return min(bad, 100)


if __name__ == "__main__":
    sys.exit(main())
