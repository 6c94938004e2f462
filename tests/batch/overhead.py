# SPDX-License-Identifier: Apache-2.0
"""What a batch costs beyond its captures: `python -m tests.batch.overhead [COUNT] [JOBS]`, Linux.

The same small captures one by one and as a batch: seconds of the processor of all processes, those
counted that outlive their starter, and seconds on the clock.
"""

from __future__ import annotations

import ctypes
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable
from pathlib import Path

from robir.batch.local import worker_environment
from robir.jobs.paths import JobPaths
from robir.specimen import write_specimen
from tests.batch.kills import LEAST

_SET_CHILD_SUBREAPER = 36


def spent(commands: Iterable[list[str]]) -> tuple[float, float, float]:
    """Seconds of the processor, on the clock, and of the processor by the last command alone."""
    before, begin, own = resource.getrusage(resource.RUSAGE_CHILDREN), time.monotonic(), 0.0
    for command in commands:
        process = subprocess.Popen(
            command,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            env=worker_environment(),
            cwd="/",
        )
        while process.poll() is None:
            words = Path(f"/proc/{process.pid}/stat").read_text().rpartition(")")[2].split()
            own = (int(words[11]) + int(words[12])) / os.sysconf("SC_CLK_TCK")
            time.sleep(0.1)
        while True:  # what outlives its starter becomes a child of this process
            try:
                os.wait()
            except ChildProcessError:
                break
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    used = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return used, time.monotonic() - begin, own


def main() -> int:
    """Measure and say; returns 1 if the batch costs more than 3 % beyond its captures."""
    count, jobs = (*map(int, sys.argv[1:]), *(6, 2)[len(sys.argv) - 1 :])
    ctypes.CDLL(None).prctl(_SET_CHILD_SUBREAPER, 1)
    robir = [sys.executable, "-P", "-m", "robir"]
    settings = [word for item in LEAST for word in ("--set", item)]
    with tempfile.TemporaryDirectory(prefix="robir-overhead-") as name:
        folder = Path(name)
        shots = [folder / "shots" / f"sphere_{number}" for number in range(count)]
        for shot in shots:
            write_specimen(shot)
        about = folder / "about.toml"
        about.write_text('catalogue = "shots"\n')
        each = [
            [*robir, "reconstruct", str(s), "-o", str(folder / "single" / s.name), *settings,
             "--asset", str(about), "--progress", "json"]
            for s in shots
        ]  # fmt: skip
        library = ["-o", str(folder / "library"), "--jobs", str(jobs), "--progress", "plain"]
        spent(each[:1])  # what a first run has to read
        single = spent([[*c[:7], f"{c[7]}_again", *c[8:]] for c in each])
        batch = spent([[*robir, "batch", *map(str, shots), *settings, *library]])
        made = [JobPaths(folder / "single" / f"{shot.name}_again") for shot in shots]
        made += [JobPaths(folder / "library" / shot.name) for shot in shots]
        assert all(paths.library_asset.is_file() for paths in made)
        print(f"single runs: {single[0]:.1f} CPU-s, {single[1]:.1f} s")
        print(f"batch of {jobs} at a time: {batch[0]:.1f} CPU-s, {batch[1]:.1f} s")
        print(f"of which the batch itself: {batch[2]:.1f} CPU-s, {batch[2] / single[0]:.1%}")
        print(f"CPU {batch[0] / single[0] - 1.0:+.1%}, clock {batch[1] / single[1]:.2f}")
    return int(batch[0] > 1.03 * single[0])


if __name__ == "__main__":
    sys.exit(main())
