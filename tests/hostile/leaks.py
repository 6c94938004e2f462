# SPDX-License-Identifier: Apache-2.0
"""Many runs after one another in one process: `python -m hostile.leaks COUNT [FOLDER]`.

Prints the memory after each; fails if it still grows by more than 2 % once a quarter of the runs
has filled what is filled once.
"""

from __future__ import annotations

import contextlib
import gc
import io
import os
import shutil
import sys
import tempfile
from pathlib import Path

import numpy as np
from hostile.tiny_run import words

from robir import cli
from robir.specimen import write_specimen

MOST_GROWTH = 0.02  # of the memory, between the second and the last quarter of the runs


def resident_bytes() -> int:
    """Memory of this process now, unused parts that were given back apart."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")


def memory_after_runs(count: int, folder: Path) -> list[int]:
    """Resident bytes after each of some runs of all stages, Blender apart."""
    write_specimen(folder / "capture")
    found = []
    for _ in range(count):
        out = folder / "out"
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
            code = cli.main(words(folder / "capture", out, has_renders=False))
        assert code in (0, 5), code
        shutil.rmtree(out)
        gc.collect()
        found.append(resident_bytes())
    return found


def growth(memory: list[int]) -> float:
    """Share by which the median of the last quarter exceeds that of the second."""
    quarter = max(1, len(memory) // 4)
    return float(np.median(memory[-quarter:]) / np.median(memory[quarter : 2 * quarter]) - 1.0)


def main() -> int:
    """Run and judge."""
    with tempfile.TemporaryDirectory(prefix="robir-leaks-") as folder:
        memory = memory_after_runs(int(sys.argv[1]), Path(folder))
    print(" ".join(f"{size / 1e6:.0f}" for size in memory), "MB")
    grown = growth(memory)
    print(f"{len(memory)} runs: memory grew by {100 * grown:.2f} %")
    return int(grown > MOST_GROWTH)


if __name__ == "__main__":
    sys.exit(main())
